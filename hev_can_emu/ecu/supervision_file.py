"""The shape of supervision in a bindings file; request ports are named as the bindings name them.

Annotations are evaluated where they stand: msgspec takes three times as long to evaluate each as a text.
"""

from typing import Annotated, Literal

import msgspec

Reaction = Literal["hold", "ramp_to_zero", "substitute", "open_clutch", "limp_home"]
Check = Literal["refuse", "ignore"]
Limited = Literal["refuse", "limit"]


class _Record(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    pass


class Slew(_Record, frozen=True):
    """How fast a request may change (``rate``, per second), and what is done with a faster one."""

    rate: str
    action: Limited = "refuse"


class Limits(_Record, frozen=True):
    """Between which values a request makes sense, and what is done with others."""

    low: str
    high: str
    action: Limited = "refuse"


class Plausible(_Record, frozen=True):
    """What the plant must say for a request to make sense.

    Either the request (``port``) lies ``within`` so much of a status port (``of``); or, where the request
    equals the code ``when``, the status port lies between ``low`` and ``high``.
    """

    port: str
    of: str
    within: str = ""
    when: int | None = None
    low: str = ""
    high: str = ""


class Debounce(_Record, frozen=True):
    """How many bad frames in a row lose a request before its time-out (0: none do), how many good heal it."""

    failed: Annotated[int, msgspec.Meta(ge=0, le=10000)] = 0
    healed: Annotated[int, msgspec.Meta(ge=1, le=10000)] = 1


class LimpHome(_Record, frozen=True):
    """Torque that the fully pressed accelerator gives in D, fading out at ``speed``."""

    torque: str
    speed: str = "40 km/h"


class Supervision(_Record, frozen=True):
    """How a request message is watched, and what its unit does when the request is lost.

    Lost after ``timeout_periods`` periods without a good frame (``period`` as a quantity where the DBC
    has no cycle time), or as ``debounce`` says; then ``reaction`` acts on the request ports in ``covers``
    (empty: all of the message), within ``ramp_down``.  ``status`` is the status port that tells how the
    message fares, ``code`` the trouble code (``U1101``), confirmed after ``confirm_cycles`` operation
    cycles in a row with a failure.

    ``crc``, ``counter_frozen``, ``counter_jump`` and ``range`` say whether such a frame is refused;
    ``limits``, ``slew`` (by port) and ``plausible`` narrow what makes sense.
    """

    status: str = ""
    timeout_periods: Annotated[int, msgspec.Meta(ge=1, le=1000)] = 3
    period: str = ""
    reaction: Reaction = "hold"
    ramp_down: str = "200 ms"
    covers: tuple[str, ...] = ()
    substitute: dict[str, str | float] = {}
    limp_home: LimpHome | None = None
    crc: Check = "refuse"
    counter_frozen: Check = "refuse"
    counter_jump: Check = "refuse"
    range: Literal["refuse", "limit", "ignore"] = "refuse"
    limits: dict[str, Limits] = {}
    slew: dict[str, Slew] = {}
    plausible: tuple[Plausible, ...] = ()
    debounce: Debounce = Debounce()
    code: str = ""
    confirm_cycles: Annotated[int, msgspec.Meta(ge=1, le=255)] = 1
