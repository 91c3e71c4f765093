"""A DBC file's text: reading it, finding places in it, and what cantools has to say, with file and line."""

from __future__ import annotations

import re
from pathlib import Path

import msgspec

from hev_can_emu.errors import InputError

FORMAT = "a DBC file (text that begins with VERSION, NS_, BU_ or BO_)"


class DbcText(msgspec.Struct, frozen=True):
    """A DBC file's path and text, and where in it something stands."""

    path: Path
    text: str

    @classmethod
    def read(cls, path: Path) -> DbcText:
        """Read the file (UTF-8, else Windows-1252); raises InputError where it is no text."""
        try:
            content = path.read_bytes()
        except OSError as error:
            reason = error.strerror or str(error)
            raise InputError(str(path), "a readable DBC file", reason.lower()) from error
        if b"\0" in content:
            line = content[: content.index(b"\0")].count(b"\n") + 1
            raise InputError(f"{path}:{line}", FORMAT, "binary data (a zero byte)")
        for encoding in ("utf-8-sig", "cp1252"):
            try:
                text = content.decode(encoding)
            except UnicodeDecodeError:
                continue
            if not text.strip():
                raise InputError(str(path), FORMAT, "an empty file")
            return cls(path, text)
        raise InputError(str(path), FORMAT, "bytes that are neither UTF-8 nor Windows-1252")

    def line_of(self, message: str = "", signal: str = "") -> int:
        """Return the line that defines a message, or a signal of it; 0 where it is not found."""
        inside = not message
        for number, line in enumerate(self.text.splitlines(), start=1):
            words = line.replace(":", " ").split()
            if len(words) > 2 and words[0] == "BO_":
                inside = not message or words[2] == message
                if inside and not signal:
                    return number
            elif inside and signal and len(words) > 1 and words[0] == "SG_" and words[1] == signal:
                return number
        return 0

    def line_with(self, word: str) -> int:
        """Return the first line that holds ``word``, preferring those that use it; else 0."""
        lines = self.text.splitlines()
        pattern = re.compile(rf"(?<!\w){re.escape(word)}(?!\w)")
        hits = [number for number, line in enumerate(lines, start=1) if pattern.search(line)]
        return hits[0] if hits and word else 0

    def where(self, line: int = 0) -> str:
        """Return ``path:line``, or the path alone for line 0."""
        return f"{self.path}:{line}" if line else str(self.path)

    def error_at(self, position: int, expected: str, got: str) -> InputError:
        """Return an InputError at a place in the text."""
        return InputError(self.where(self.text.count("\n", 0, position) + 1), expected, f"'{got}'")

    def error(
        self, expected: str, got: str, hint: str = "", message: str = "", signal: str = ""
    ) -> InputError:
        """Return an InputError at the line of a message or signal."""
        return InputError(self.where(self.line_of(message, signal)), expected, got, hint)


#: Numbers for which cantools would fill the memory: (what stands there, the largest usable, in words).
_SIZES = (
    (re.compile(r"\bBO_\s+\d+\s+\w+\s*:\s*(\d+)"), 1 << 16, "a message of 0 to 64 bytes"),
    (re.compile(r"\bSG_\s[^:\n]*:\s*(\d+)\s*\|"), 1 << 19, "a start bit inside the message"),
    (re.compile(r"\bSG_\s[^:\n]*:\s*\d+\s*\|\s*(\d+)"), 1 << 12, "a signal of 1 to 64 bits"),
)
_RANGE = re.compile(r"\b(\d+)\s*-\s*(\d+)")
_MOST_SELECTORS = 1 << 16


def check_sizes(source: DbcText) -> None:
    """Refuse what no parser should be asked to build."""
    for pattern, most, expected in _SIZES:
        for match in pattern.finditer(source.text):
            if len(match[1]) > 9 or int(match[1]) > most:
                raise source.error_at(match.start(1), expected, match[1][:40])
    selectors = 0
    for line in re.finditer(r"^\s*SG_MUL_VAL_[^;]*", source.text, re.MULTILINE):
        for match in _RANGE.finditer(line[0]):
            first, last = (int(text[:30]) for text in match.groups())
            selectors += max(last - first, 0)
            if selectors > _MOST_SELECTORS:
                expected = f"at most {_MOST_SELECTORS} multiplexer values"
                raise source.error_at(line.start() + match.start(), expected, match[0][:40])


def translate(source: DbcText, error: Exception) -> InputError:
    """Return what cantools raised as an error with file and line."""
    text = " ".join(str(error).split())
    if match := re.search(r"Invalid syntax at line (\d+), column (\d+)", text):
        line = int(match[1])
        lines = source.text.splitlines()
        content = lines[line - 1] if 0 < line <= len(lines) else ""
        got = f"'{content.strip()[:60]}'" if content.strip() else "the end of the file"
        return InputError(source.where(line), f"DBC syntax (column {match[2]})", got)
    if match := re.search(r"signals (\S+) and (\S+) are overlapping in message (\S+)\.$", text):
        first, second, message = match.groups()
        if first == second:
            expected, got = f"signal names that occur once in {message}", f"'{first}' twice"
            return source.error(expected, got, message=message, signal=first)
        return source.error(
            f"signals of {message} that do not overlap",
            f"'{first}' and '{second}' on the same bits",
            message=message,
            signal=first,
        )
    if match := re.search(r"signal (\S+) does not fit in message (\S+)\.$", text):
        signal, message = match.groups()
        return source.error(
            f"a signal inside {message}",
            f"'{signal}' beyond its last bit",
            message=message,
            signal=signal,
        )
    if match := re.search(
        r"signal (\S+) length (\S+) is not greater than 0 in message (\S+)", text
    ):
        signal, length, message = match.groups()
        message = message.rstrip(".")
        return source.error(
            "a signal of at least one bit", f"{length}", message=message, signal=signal
        )
    if match := re.search(
        r"frame id (0x[0-9a-f]+) is more than (\d+) bits in message (\S+)\.", text
    ):
        return source.error(f"an identifier of {match[2]} bits", match[1], message=match[3])
    if isinstance(error, KeyError):
        words = str(error.args[0]).split() if error.args else []
        line = source.line_with(words[0]) if words else 0
        got = f"'{' '.join(words)}'"
        return InputError(source.where(line), "a name that the file defines", got)
    if match := re.search(r"unused (VAL_|SIG_VALTYPE_) entries in DBC: \S+ (\d+) (\S+)", text):
        pattern = rf"{match[1]}\s+{match[2]}\s+{re.escape(match[3])}\b"
        found = re.search(pattern, source.text)
        line = source.text[: found.start()].count("\n") + 1 if found else 0
        return InputError(
            source.where(line),
            f"a signal of message {match[2]} that {match[1]} belongs to",
            f"'{match[3]}', which that message lacks",
        )
    return InputError(str(source.path), "a valid DBC file", text or type(error).__name__)
