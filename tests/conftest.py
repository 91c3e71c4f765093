"""What all tests share: the random tests' settings and the repository's root."""

import os
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


@pytest.fixture(scope="session")
def repository() -> Path:
    """The repository's root."""
    return Path(__file__).resolve().parent.parent
