"""The TCU's shift control for the detailed synchronizer: which way to push, and how hard.

Once per control period, from where the sleeve is to the force to ask the hydraulics for:

| phase | force | leaves when |
|---|---|---|
| NEUTRAL | centring | a gear is requested with enough force: TRAVEL |
| TRAVEL | to the ring: travel force; behind it: dog force | ring: SYNCHRONISING; end: ENGAGED |
| SYNCHRONISING | as requested | the ring turns: INDEX; time-out or force lost: ABORTED |
| INDEX | as requested | ring passed: TRAVEL; it turns back: SYNCHRONISING; as above: ABORTED |
| GRATING | dog force | slip gone: TRAVEL; time-out: ABORTED |
| TOOTH_ON_TOOTH | dog force | teeth turned: TRAVEL; time-out: ABORTED |
| ENGAGED | holding force for a while, then none | another request: DISENGAGING |
| DISENGAGING | out of the dogs: travel force; then centring | centre: NEUTRAL; wanted again: TRAVEL |
| BLOCKED_BY_TORQUE | as DISENGAGING | the sleeve moves: DISENGAGING; wanted again: TRAVEL |
| ABORTED | as DISENGAGING | at the centre and another request: NEUTRAL |

A request for another gear turns every phase of engaging into DISENGAGING.  A request for less force than the
phase's own limits it; below the least it counts as none, except for centring, which needs no request.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from hev_can_emu.jit import kernel
from hev_can_emu.plant import checks, sleeve
from hev_can_emu.plant import torque_source as source

# Phases; the numbers are those of the control units' ports.
NEUTRAL, TRAVEL, SYNCHRONISING, INDEX, ENGAGED = 0, 1, 2, 3, 4
DISENGAGING, ABORTED, BLOCKED_BY_TORQUE, GRATING, TOOTH_ON_TOOTH = 5, 6, 7, 8, 9

BETWEEN = 3
"""The gear told while the sleeve is neither at the centre nor in a gear."""

# Layout of the packed parameters.
P_DT, P_MAX_FORCE, P_LEAST_FORCE, P_TRAVEL_FORCE, P_DOG_FORCE = 0, 1, 2, 3, 4
P_HOLDING_FORCE, P_HOLDING_TIME, P_CENTRING_FORCE = 5, 6, 7
P_CENTRING_STIFFNESS, P_CENTRING_DAMPING, P_CENTRE_BAND, P_SPEED_SHARE = 8, 9, 10, 11
P_TIMEOUT, P_LOST_TIME, P_STILL_TIME, P_STILL_SPEED = 12, 13, 14, 15
N_PARAMETERS = 16

# Layout of the state: phase, gear aimed at, time since the ring blocked s, time without force or of
# holding s, time of standing s, position last seen m, filtered velocity m/s, 1 once the ring blocked.
X_PHASE, X_TARGET, X_SHIFT_TIME, X_WAIT, X_STILL = 0, 1, 2, 3, 4
X_POSITION, X_SPEED, X_RUNNING = 5, 6, 7
N_STATE = 8

# Layout of the output: force request N, positive towards G1; phase; gear aimed at; gear told;
# slip against the gear aimed at, rad/s; LIMIT_* code.
OUT_FORCE, OUT_PHASE, OUT_TARGET, OUT_GEAR, OUT_SLIP, OUT_REASON = 0, 1, 2, 3, 4, 5
N_OUT = 6

_HALF_NS = 5e-10


class ShiftControlParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Forces and times; SI units.  The defaults are for the default car (docs/detailed/synchronizer.md).

    Attributes:
        max_force: greatest force asked for, N.
        least_force: a request below it counts as none, N.
        travel_force: on the way to the ring and out of the dogs, N; a smaller request limits it.
        dog_force: from the ring to the end stop, N; a smaller request limits it.
        holding_force: at the end stop, N, for
        holding_time: s; then the detent holds alone.
        centring_force: greatest force of the centring, N.
        centring_stiffness, centring_damping: its gains, N/m and N s/m.
        centre_band: distance from the centre at which the sleeve counts as there, m.
        speed_time: filter of the sleeve's speed, s.
        timeout: longest time from blocking to engaging, s.
        lost_force_time: the shift is given up after so long without force, s.
        still_time: standing so long under force in the dogs counts as blocked, s.
        still_speed: below it the sleeve counts as standing, m/s.
    """

    max_force: float = 2000.0
    least_force: float = 50.0
    travel_force: float = 700.0
    dog_force: float = 800.0
    holding_force: float = 200.0
    holding_time: float = 0.05
    centring_force: float = 250.0
    centring_stiffness: float = 1.5e5
    centring_damping: float = 1500.0
    centre_band: float = 4e-4
    speed_time: float = 0.002
    timeout: float = 1.0
    lost_force_time: float = 0.05
    still_time: float = 0.03
    still_speed: float = 0.003

    def validate(self, where: str) -> None:
        """Raise :class:`hev_can_emu.errors.InputError` naming the first value that makes no sense."""
        checks.positive(where, self, "least_force", "centring_force", "centring_stiffness")
        checks.ordered(where, self, "least_force", "travel_force")
        checks.ordered(where, self, "least_force", "dog_force")
        checks.ordered(where, self, "least_force", "max_force")
        checks.positive(where, self, "centre_band", "speed_time", "timeout", "still_speed")
        checks.not_negative(where, self, "holding_force", "holding_time", "centring_damping")
        checks.not_negative(where, self, "lost_force_time", "still_time")

    def pack(self, dt: float = 1e-3) -> NDArray[np.float64]:
        """Return the kernel's parameters, shape ``(N_PARAMETERS,)``, for a period of ``dt`` s."""
        return np.array(
            [
                dt,
                self.max_force,
                self.least_force,
                self.travel_force,
                self.dog_force,
                self.holding_force,
                self.holding_time,
                self.centring_force,
                self.centring_stiffness,
                self.centring_damping,
                self.centre_band,
                -np.expm1(-dt / self.speed_time),
                self.timeout,
                self.lost_force_time,
                self.still_time,
                self.still_speed,
            ]
        )


@kernel
def shift_control_start(x: NDArray[np.float64], gear: float, position: float) -> None:
    """Set the state to rest with the sleeve at ``position`` m: neutral, or with a gear engaged."""
    for i in range(N_STATE):
        x[i] = 0.0
    x[X_POSITION] = position
    if gear != 0.0:
        x[X_TARGET] = gear
        x[X_PHASE] = ENGAGED
        x[X_WAIT] = math.inf  # held by its notch


@kernel
def _choose(x: NDArray[np.float64], gear: float, force: float, least: float, centred: bool) -> None:
    """Change phase where the request alone decides it."""
    phase = x[X_PHASE]
    wanted = gear == x[X_TARGET]
    if phase == NEUTRAL:
        if gear != 0.0 and force >= least:
            x[X_TARGET] = gear
            x[X_PHASE] = TRAVEL
            x[X_RUNNING] = x[X_SHIFT_TIME] = x[X_WAIT] = x[X_STILL] = 0.0
    elif phase == ABORTED:
        if not wanted and centred:
            x[X_PHASE] = NEUTRAL
            x[X_TARGET] = 0.0
    elif phase in (DISENGAGING, BLOCKED_BY_TORQUE):
        if wanted:
            x[X_PHASE] = TRAVEL
            x[X_RUNNING] = x[X_SHIFT_TIME] = x[X_WAIT] = x[X_STILL] = 0.0
    elif not wanted:
        x[X_PHASE] = DISENGAGING
        x[X_STILL] = 0.0


@kernel
def _engage(p: NDArray[np.float64], x: NDArray[np.float64], zone: float, pushed: bool) -> None:
    """Name the phase of a shift under way from the sleeve's place; give up what takes too long."""
    if zone in (sleeve.BLOCKED, sleeve.INDEXING):
        x[X_RUNNING] = 1.0
        x[X_WAIT] = 0.0 if pushed else x[X_WAIT] + p[P_DT]
        x[X_PHASE] = SYNCHRONISING if zone == sleeve.BLOCKED else INDEX
        if x[X_WAIT] > p[P_LOST_TIME] + _HALF_NS:
            x[X_PHASE] = ABORTED
    elif zone == sleeve.GRATING:
        x[X_PHASE] = GRATING
    elif zone == sleeve.TOOTH_ON_TOOTH and x[X_STILL] >= p[P_STILL_TIME] - _HALF_NS:
        x[X_PHASE] = TOOTH_ON_TOOTH
    elif zone == sleeve.STOP or (
        zone == sleeve.ENGAGED and x[X_STILL] >= p[P_STILL_TIME] - _HALF_NS
    ):
        x[X_PHASE] = ENGAGED
        x[X_WAIT] = 0.0
        return
    elif zone != sleeve.TOOTH_ON_TOOTH or x[X_PHASE] != TOOTH_ON_TOOTH:
        x[X_PHASE] = TRAVEL
    if x[X_RUNNING] > 0.5:
        if x[X_SHIFT_TIME] >= p[P_TIMEOUT] - _HALF_NS:
            x[X_PHASE] = ABORTED
        x[X_SHIFT_TIME] += p[P_DT]


@kernel
def _push(p: NDArray[np.float64], phase: float, zone: float, force: float, held: float) -> float:
    """Return the force towards the gear, N, magnitude; ``held``: time at the end stop, s."""
    if phase == ENGAGED:
        return float(p[P_HOLDING_FORCE] if held < p[P_HOLDING_TIME] - _HALF_NS else 0.0)
    if force < p[P_LEAST_FORCE]:
        return 0.0
    if zone in (sleeve.BLOCKED, sleeve.INDEXING):
        return force
    return min(force, float(p[P_TRAVEL_FORCE] if zone <= sleeve.PRESYNC else p[P_DOG_FORCE]))


@kernel
def shift_control_step(
    p: NDArray[np.float64],
    x: NDArray[np.float64],
    gear_request: float,
    force_request: float,
    position: float,
    slip1: float,
    slip2: float,
    zone: float,
    torque: float,
    out: NDArray[np.float64],
) -> None:
    """Act once per control period.

    Args:
        p: parameters, ``(N_PARAMETERS,)``.
        x: state, ``(N_STATE,)``, changed in place; see :func:`shift_control_start`.
        gear_request: 0 neutral, 1 G1, 2 G2; NaN or anything else: as before.
        force_request: magnitude, N; NaN counts as 0.
        position: of the sleeve, m, positive towards G1.
        slip1, slip2: sleeve speed minus the speed of each gear, rad/s.
        zone: of :mod:`hev_can_emu.plant.sleeve`.
        torque: that the lock of sleeve and engaged gear carries, N m.
        out: ``(N_OUT,)``: force request N, positive towards G1; phase; gear aimed at; gear told (3:
            between); slip against the gear aimed at, rad/s; LIMIT_* code.
    """
    gear = x[X_TARGET]
    if gear_request in (0.0, 1.0, 2.0):
        gear = gear_request
    force = 0.0 if math.isnan(force_request) else min(max(force_request, 0.0), p[P_MAX_FORCE])
    pushed = force >= p[P_LEAST_FORCE]
    x[X_SPEED] += ((position - x[X_POSITION]) / p[P_DT] - x[X_SPEED]) * p[P_SPEED_SHARE]
    x[X_POSITION] = position
    centred = abs(position) <= p[P_CENTRE_BAND]
    x[X_STILL] = x[X_STILL] + p[P_DT] if abs(x[X_SPEED]) < p[P_STILL_SPEED] and pushed else 0.0

    if x[X_PHASE] == NEUTRAL and zone >= sleeve.ENTERING:
        # Found in gear at the start: so be it until another gear is asked for.
        shift_control_start(x, 1.0 if position > 0.0 else 2.0, position)
        if gear_request not in (0.0, 1.0, 2.0):
            gear = x[X_TARGET]
    _choose(x, gear, force, p[P_LEAST_FORCE], centred)
    target = x[X_TARGET]
    side = 0.0 if target == 0.0 else (1.0 if target == 1.0 else -1.0)
    if side * position < 0.0:
        zone = float(sleeve.FREE)  # still on the other gear's side
    in_dogs = zone >= sleeve.ENTERING
    phase = x[X_PHASE]
    if phase in (TRAVEL, SYNCHRONISING, INDEX, GRATING, TOOTH_ON_TOOTH):
        _engage(p, x, zone, pushed)
    elif phase == ENGAGED:
        x[X_WAIT] += p[P_DT]
        if not in_dogs:
            x[X_PHASE] = TRAVEL
            x[X_RUNNING] = x[X_SHIFT_TIME] = x[X_WAIT] = 0.0
    elif phase in (DISENGAGING, BLOCKED_BY_TORQUE):
        standing = x[X_STILL] >= p[P_STILL_TIME] - _HALF_NS
        x[X_PHASE] = DISENGAGING
        if in_dogs and standing and torque != 0.0:
            x[X_PHASE] = BLOCKED_BY_TORQUE
        elif centred:
            x[X_PHASE] = NEUTRAL
            x[X_TARGET] = 0.0

    phase = x[X_PHASE]
    if phase in (NEUTRAL, DISENGAGING, ABORTED, BLOCKED_BY_TORQUE):
        if in_dogs and phase != NEUTRAL:
            pull = p[P_TRAVEL_FORCE] if phase == ABORTED else min(force, p[P_TRAVEL_FORCE])
            out[OUT_FORCE] = -side * pull if pull >= p[P_LEAST_FORCE] else 0.0
        elif not centred:
            wanted = -p[P_CENTRING_STIFFNESS] * position - p[P_CENTRING_DAMPING] * x[X_SPEED]
            most = p[P_CENTRING_FORCE]
            out[OUT_FORCE] = min(max(wanted, -most), most)
        else:
            out[OUT_FORCE] = 0.0
    else:
        out[OUT_FORCE] = side * _push(p, phase, zone, force, x[X_WAIT])
    out[OUT_PHASE] = phase
    out[OUT_TARGET] = x[X_TARGET]
    out[OUT_GEAR] = x[X_TARGET] if phase == ENGAGED else (0.0 if centred else float(BETWEEN))
    out[OUT_SLIP] = slip1 if x[X_TARGET] == 1.0 else (slip2 if x[X_TARGET] == 2.0 else 0.0)
    out[OUT_REASON] = source.LIMIT_NONE
    if phase == BLOCKED_BY_TORQUE:
        out[OUT_REASON] = source.LIMIT_TORQUE_ON_DOGS
    elif phase == ABORTED:
        out[OUT_REASON] = source.LIMIT_SYNC_TIMEOUT
