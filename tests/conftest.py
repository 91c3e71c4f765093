"""What all tests share: random tests' settings, the repository's root, which tests run kernels."""

import os
import signal
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# A first call may compile, so no deadlines; the same examples in every run, so that a failure on
# one machine is a failure on all (HYPOTHESIS_PROFILE=explore looks for new ones).
_INTERPRETED = os.environ.get("NUMBA_DISABLE_JIT", "0") != "0"
_COMMON = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}
settings.register_profile(
    "fixed", derandomize=True, max_examples=20 if _INTERPRETED else 100, **_COMMON
)
settings.register_profile("explore", max_examples=1000, **_COMMON)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "fixed"))

# Whoever starts the tests in the background lets all their children ignore Ctrl-C, which some must hear.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

TESTS = Path(__file__).resolve().parent

# Rooms whose tests run compiled bodies: they also run as plain Python and with bounds checks, save
# those marked `compiled` because they would take too long so.
KERNEL_ROOMS = frozenset({"machines", "plant", "messages", "ecu"})


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests of the rooms above, before `-m` chooses."""
    for item in items:
        if item.path.relative_to(TESTS).parts[0] in KERNEL_ROOMS and not any(
            item.iter_markers("compiled")
        ):
            item.add_marker("kernels")


@pytest.fixture(scope="session")
def repository() -> Path:
    """The repository's root."""
    return TESTS.parent
