"""What both engines' control units share: the state machine, the idle governor, what their speeds must be.

State machine (``run`` is the run request)::

    OFF      -> CRANKING  run
    CRANKING -> RUNNING   speed >= cranking speed          CRANKING -> OFF  not run
    RUNNING  -> STALLED   speed < stall speed              RUNNING  -> OFF  not run
    STALLED  -> RUNNING   run, speed >= cranking speed     STALLED  -> OFF  not run
    any      -> FAULT     not healthy                      FAULT    -> OFF  healthy and not run

The idle governor is a PI controller with the drag as feed-forward; it may raise the combustion torque
above the request, and lowers it only near idle speed and near a request of zero.
"""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from hev_can_emu.jit import small_kernel
from hev_can_emu.plant import checks

OFF, CRANKING, RUNNING, STALLED, FAULT = 0, 1, 2, 3, 4

_IDLE_WINDOW = 30.0  # rad/s above idle speed, over which the governor's authority fades
_IDLE_REQUEST = 5.0  # N m after friction, over which it fades too


def check_speeds(where: str, record: Any) -> None:
    """Raise :class:`hev_can_emu.errors.InputError` naming the first speed or gain that makes no sense."""
    checks.positive(where, record, "drag_fade_speed", "stall_speed", "idle_torque_max")
    checks.ordered(where, record, "stall_speed", "crank_speed", "idle_speed")
    checks.ordered(where, record, "idle_speed", "fade_speed", "max_speed", "cut_speed")
    checks.ordered(where, record, "fade_speed", "resume_speed", "cut_speed")
    checks.not_negative(where, record, "idle_gain", "idle_integral_gain")


@small_kernel
def next_phase(
    phase: float, run: float, healthy: float, speed: float, crank_speed: float, stall_speed: float
) -> float:
    """Return the state machine's next phase (see the module's table)."""
    if healthy < 0.5:
        return float(FAULT)
    if run < 0.5:
        return float(OFF)
    if phase == FAULT:  # until the run request is withdrawn
        return phase
    if phase == RUNNING:
        return float(STALLED) if speed < stall_speed else phase
    if speed >= crank_speed:
        return float(RUNNING)
    return float(STALLED) if phase == STALLED else float(CRANKING)


@small_kernel
def govern_idle(
    x: NDArray[Any],
    at: int,
    asked: float,
    request: float,
    error: float,
    base: float,
    integral_step: float,
    keep: float,
    limit: float,
) -> float:
    """Return the combustion torque to ask for, N m.

    At least what keeps the idle speed; and less than asked where next to nothing is requested near
    idle, since no torque after friction would hold any speed instead of idling.

    Args:
        x: state; ``x[at]`` is the governor's integral, N m, changed in place.
        at: see ``x``.
        asked: combustion torque without the governor, N m.
        request: torque after friction, N m.
        error: idle speed less speed, rad/s.
        base: drag at idle speed and the proportional part, N m.
        integral_step: what the integral grows by per speed and period, N m s/rad.
        keep: share of it that outlasts a period off idle, 1.
        limit: greatest combustion torque, N m.
    """
    authority = min(max(1.0 + error / _IDLE_WINDOW, 0.0), 1.0)
    authority *= min(max(1.0 - request / _IDLE_REQUEST, 0.0), 1.0)
    integral = x[at] + integral_step * error
    wish = base + integral
    if wish < limit:
        if wish > 0.0 and (wish >= asked or authority > 0.0):
            x[at] = integral
        else:
            x[at] *= keep
    governed: float = min(max(base + x[at], 0.0), limit)
    if governed >= asked:
        return governed
    return float(asked + (governed - asked) * authority)
