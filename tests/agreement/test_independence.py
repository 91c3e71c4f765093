"""The reference shares no code with what it is held against."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]
REFERENCE = TESTS / "reference"
ALLOWED = {
    "__future__", "argparse", "bisect", "collections", "hashlib", "json", "math", "numpy", "pathlib",
    "reference", "scipy", "sys", "time", "typing", "yaml",
}  # fmt: skip


def imported(path: Path) -> set[str]:
    """Return the top-level packages that a module imports anywhere in it."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name}: relative import"
            found.add((node.module or "").partition(".")[0])
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            assert node.func.id not in ("__import__", "exec", "eval"), path.name
    return found


def test_it_imports_only_libraries_and_itself() -> None:
    modules = sorted(REFERENCE.glob("*.py"))
    assert len(modules) >= 10
    for module in modules:
        assert imported(module) <= ALLOWED, module.name


def test_running_it_loads_nothing_of_the_product() -> None:
    code = (
        f"import sys; sys.path.insert(0, {str(TESTS)!r}); import reference.compute;"
        "print([name for name in sys.modules if name.startswith('hev_can_emu')])"
    )
    # -I: neither the current folder nor the environment may lend it a path.
    done = subprocess.run([sys.executable, "-I", "-c", code], capture_output=True, text=True)
    assert done.stdout.strip() == "[]", done.stderr
