"""The shape of an expectation in a scenario file.

Annotations are evaluated where they stand, as in :mod:`.schema`.
"""

from typing import Annotated, Literal

import msgspec

Text = Annotated[str, msgspec.Meta(min_length=1)]
#: bool only so that it can be refused with a better word than "number"
Value = int | float | str | bool
Names = tuple[Text, ...]


class Record(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of everything in a scenario file: unknown keys are refused."""


class Until(Record, frozen=True):
    """``holds`` holds at every tick before the one at which ``comes`` does."""

    holds: Text
    comes: Text


class Settles(Record, frozen=True):
    """``value`` comes within ``band`` of ``to`` and stays there."""

    value: Text
    to: Value
    band: Value


class Equals(Record, frozen=True):
    """``value`` is within ``tolerance`` of ``to``."""

    value: Text
    to: Value
    tolerance: Value = 0.0


class Overshoot(Record, frozen=True):
    """``value`` goes beyond ``to`` by no more than ``limit``; a limit in % counts from the way there."""

    value: Text
    to: Value
    limit: Value


class RiseTime(Record, frozen=True):
    """``value`` gets from ``low`` to ``high`` of its way to ``to`` within the time ``limit``."""

    value: Text
    to: Value
    limit: Value
    low: Value = "10 %"
    high: Value = "90 %"


class Monotone(Record, frozen=True):
    """``value`` goes one way, back by no more than ``tolerance``."""

    value: Text
    direction: Literal["rising", "falling"] = "rising"
    tolerance: Value = 0.0


class Sequence(Record, frozen=True):
    """``value`` takes the values ``of`` in this order; ``exactly`` allows no other between."""

    value: Text
    of: Annotated[tuple[Value, ...], msgspec.Meta(min_length=1)]
    exactly: bool = False


class Follows(Record, frozen=True):
    """Each time ``cause`` comes to hold, ``effect`` holds at some tick ``within`` a time from then on."""

    cause: Text
    effect: Text
    within: Value


class Count(Record, frozen=True):
    """``of`` comes to hold at least ``min`` and at most ``max`` times."""

    of: Text
    min: Annotated[int, msgspec.Meta(ge=0)] = 0
    max: Annotated[int, msgspec.Meta(ge=0)] | None = None


class Period(Record, frozen=True):
    """The frames of ``message`` come every ``of``, each interval within ``jitter`` of it."""

    message: Text
    of: Value
    jitter: Value


class Jerk(Record, frozen=True):
    """The slope of an acceleration (or of a speed's slope) over the span ``over`` stays within ``limit``."""

    value: Text
    limit: Value
    over: Value = "50 ms"


class VibrationDose(Record, frozen=True):
    """The vibration dose value (ISO 2631-1) of an acceleration stays within ``limit``."""

    value: Text
    limit: Value
    weighting: Literal["none", "Wk", "Wd"] = "none"


class Expectation(Record, frozen=True):
    """Exactly one of the kinds, and the window in which it counts."""

    name: str = ""
    always: Text | None = None
    never: Text | None = None
    becomes: Text | None = None
    until: Until | None = None
    settles: Settles | None = None
    equals: Equals | None = None
    overshoot: Overshoot | None = None
    rise_time: RiseTime | None = None
    monotone: Monotone | None = None
    sequence: Sequence | None = None
    follows: Follows | None = None
    count: Count | None = None
    period: Period | None = None
    jerk: Jerk | None = None
    vibration_dose: VibrationDose | None = None
    at: Value | None = None
    start: Value | None = msgspec.field(default=None, name="from")
    to: Value | None = None
    length: Value | None = msgspec.field(default=None, name="for")
    within: Value | None = None
    hold: Value | None = None
