"""What a step does to signals and messages, from the file's words to what can be played."""

from __future__ import annotations

import math
from collections.abc import Iterable

from hev_can_emu.errors import InputError, did_you_mean
from hev_can_emu.scenario import schema, script
from hev_can_emu.scenario.expectation_schema import Value
from hev_can_emu.scenario.place import Place
from hev_can_emu.scenario.program import (
    Action,
    Clear,
    Command,
    Hold,
    Inject,
    Release,
    SendFrame,
    SendMessage,
    Set,
    Shape,
    Tables,
)
from hev_can_emu.scenario.signals import Signal
from hev_can_emu.scenario.values import Values
from hev_can_emu.units import Unit

FD_LENGTHS = (*range(9), 12, 16, 20, 24, 32, 48, 64)


class StimulusCompiler:
    """Takes a step's stimuli; raises InputError here and in every method.

    Args:
        values: what texts mean.
        plays: the nodes whose signals the scenario sets.
        tables: where code and samples are collected.
    """

    def __init__(self, values: Values, plays: tuple[str, ...], tables: Tables) -> None:
        self._values = values
        self._plays = plays
        self._tables = tables
        self._faults: dict[str, None] = {}

    def actions(self, step: schema.Step, place: Place) -> Iterable[tuple[Signal, Action]]:
        """Yield what happens to signals."""
        taken: dict[int, str] = {}

        def own(name: str, key: str, here: Place) -> Signal:
            signal = self._playable(name, here)
            if signal.index in taken:
                got = f"'{name}' in '{taken[signal.index]}' and '{key}'"
                raise here.refuse("each signal once in a step", got)
            taken[signal.index] = key
            return signal

        for name, value in step.set.items():
            here = place / "set" / name
            signal = own(name, "set", here)
            yield signal, Set(signal.parse(self._values.resolve(value), here))
        for name, ramp in step.ramp.items():
            here = place / "ramp" / name
            yield (signal := own(name, "ramp", here)), self._ramp(signal, ramp, here)
        for name, text in step.follow.items():
            here = place / "follow" / name
            yield (signal := own(name, "follow", here)), self._follow(signal, text, here)
        for name, sine in step.sine.items():
            here = place / "sine" / name
            yield (signal := own(name, "sine", here)), self._sine(signal, sine, here)
        for name, chirp in step.chirp.items():
            here = place / "chirp" / name
            yield (signal := own(name, "chirp", here)), self._chirp(signal, chirp, here)
        for name, train in step.train.items():
            here = place / "train" / name
            yield (signal := own(name, "train", here)), self._train(signal, train, here)
        for name, profile in step.profile.items():
            here = place / "profile" / name
            yield (signal := own(name, "profile", here)), self._profile(signal, profile, here)
        for number, name in enumerate(step.hold):
            yield own(name, "hold", place / "hold" / number), Hold()
        for number, name in enumerate(step.release):
            yield own(name, "release", place / "release" / number), Release()

    def commands(self, step: schema.Step, place: Place) -> Iterable[Command]:
        """Yield what happens to messages, and raw frames."""
        taken: set[str] = set()
        for key, names in (("silence", step.silence), ("resume", step.resume)):
            for number, name in enumerate(names):
                here = place / key / number
                message = self._values.signals.require_message(name, here)
                sender = self._values.signals.messages[message]
                if sender not in self._plays:
                    wanted = f"a message sent by {' or '.join(self._plays)}"
                    raise here.refuse(wanted, f"'{name}'", f"{sender or 'no node'} sends it")
                if message in taken:
                    raise here.refuse("each message once in a step", f"'{name}' again")
                taken.add(message)
                yield SendMessage(message, key == "resume")
        for number, frame in enumerate(step.send):
            yield _frame(frame, place / "send" / number)
        for number, name in enumerate(step.clear):
            if name not in self._faults:
                hint = did_you_mean(name, self._faults)
                got = f"'{name}'"
                raise (place / "clear" / number).refuse(
                    "the name of a fault injected before", got, hint
                )
            yield Clear(name)
        for number, written in enumerate(step.inject):
            here = place / "inject" / number
            fault = {
                key: self._values.resolve(value) if isinstance(value, str) else value
                for key, value in written.items()
            }
            label, parsed = self._values.scope.sources.fault(fault, here)
            self._faults[label] = None
            yield Inject(label, parsed, str(here))

    def _playable(self, name: str, place: Place) -> Signal:
        signal = self._values.signals.require(name, place)
        plays = self._plays
        if signal.sender not in plays:
            hint = f"{signal.sender or 'no node'} sends it in {signal.message}"
            raise place.refuse(f"a signal sent by {' or '.join(plays)}", f"'{name}'", hint)
        if signal.protected:
            hint = f"the protection of {signal.message} writes it"
            raise place.refuse("a signal to set", f"'{name}'", hint)
        return signal

    def _ramp(self, signal: Signal, ramp: schema.Ramp, place: Place) -> Shape:
        start = math.nan
        if ramp.start is not None:
            start = self._level(signal, ramp.start, place / "from")
        end = self._level(signal, ramp.to, place / "to")
        return Shape(script.LINE, (start, end), self._values.time(ramp.over, place / "over"))

    def _level(self, signal: Signal, value: Value, place: Place) -> float:
        number = signal.parse(self._values.resolve(value), place)
        if math.isnan(number):
            raise place.refuse("a number", f"'{value}'", "use set")
        return number

    def _follow(self, signal: Signal, text: str, place: Place) -> Shape:
        expression = self._values.expression(text, place)
        span = self._tables.add_code(expression.code)
        if expression.unit is None:
            return Shape(script.FOLLOW, (1.0, 0.0), span=span)
        own, have = signal.known_unit(place), expression.unit
        if have.dimension != own.dimension:
            hint = f"{signal.name} is in {signal.unit or 'no unit'}; number(...) drops a unit"
            wanted = f"a value in {signal.unit}" if signal.unit else "a number without unit"
            raise place.refuse(wanted, f"{have.name} from '{text}'", hint)
        gain, offset = have.gain / own.gain, (have.offset - own.offset) / own.gain
        return Shape(script.FOLLOW, (gain, offset), span=span)

    def _swing(
        self, signal: Signal, stimulus: schema.Sine | schema.Chirp, place: Place
    ) -> tuple[float, float]:
        """Return offset (NaN: the present value) and amplitude."""
        amplitude = self._values.difference(stimulus.amplitude, signal.unit, place / "amplitude")
        if stimulus.offset is None:
            return math.nan, amplitude
        offset = self._level(signal, stimulus.offset, place / "offset")
        for peak in (offset - amplitude, offset + amplitude):
            signal.parse(peak, place)
        return offset, amplitude

    def _frequency(self, value: Value, place: Place) -> float:
        frequency = self._values.si(value, "Hz", place)
        if frequency <= 0.0:
            raise place.refuse("a frequency above 0 Hz", f"'{value}'")
        return frequency

    def _sine(self, signal: Signal, sine: schema.Sine, place: Place) -> Shape:
        offset, amplitude = self._swing(signal, sine, place)
        omega = 2.0 * math.pi * self._frequency(sine.frequency, place / "frequency")
        phase = self._values.si(sine.phase, "rad", place / "phase")
        return Shape(script.WAVE, (offset, amplitude, omega, phase))

    def _chirp(self, signal: Signal, chirp: schema.Chirp, place: Place) -> Shape:
        offset, amplitude = self._swing(signal, chirp, place)
        low = self._frequency(chirp.start, place / "from")
        high = self._frequency(chirp.to, place / "to")
        over = self._positive(chirp.over, place / "over")
        mode = int(chirp.sweep == "logarithmic")
        return Shape(script.CHIRP, (offset, amplitude, low, high), over, mode=mode)

    def _positive(self, value: Value, place: Place) -> int:
        length = self._values.time(value, place)
        if length == 0:
            raise place.refuse("a time above 0 s", f"'{value}'")
        return length

    def _train(self, signal: Signal, train: schema.Train, place: Place) -> Shape:
        levels = [
            (0.0, self._level(signal, value, place / "values" / number))
            for number, value in enumerate(train.values)
        ]
        every = self._positive(train.every, place / "every")
        span = self._tables.add_rows(levels)
        return Shape(script.TRAIN, (), every, span, train.times)

    def _profile(self, signal: Signal, profile: schema.Profile, place: Place) -> Shape:
        from hev_can_emu.scenario.profile import read_profile  # few scenarios have one

        text = self._values.scope.sources.profile(profile.file, place / "file")
        own: Unit = signal.known_unit(place)
        rows = read_profile(text, profile, own, place)
        for number, (t_s, value) in enumerate(rows):
            try:
                signal.parse(value, place / "column")
            except InputError as error:
                got = f"{value:g} {signal.unit} at {t_s:g} s, row {number + 1} of {profile.file}"
                raise (place / "column").refuse(error.expected, got, error.hint) from error
        span = self._tables.add_rows(rows)
        return Shape(script.TABLE, (), 0, span, int(profile.between == "line"))


def _frame(frame: schema.RawFrame, place: Place) -> SendFrame:
    try:
        data = bytes.fromhex(frame.data)
    except ValueError:
        raise (place / "data").refuse(
            "hexadecimal bytes such as '01 a0'", f"'{frame.data}'"
        ) from None
    if frame.id > 0x7FF and not frame.extended:
        hint = "say extended: true for a 29-bit identifier"
        raise (place / "id").refuse("an identifier up to 0x7FF", f"0x{frame.id:X}", hint)
    if not frame.fd and len(data) > 8:
        hint = "say fd: true for up to 64"
        raise (place / "data").refuse("at most 8 bytes", f"{len(data)}", hint)
    if len(data) not in FD_LENGTHS:
        known = ", ".join(str(each) for each in FD_LENGTHS[9:])
        raise (place / "data").refuse("0 to 8 bytes, or " + known, f"{len(data)}")
    return SendFrame(frame.id, data, frame.extended, frame.fd)
