"""The synchronizer of G1 and G2: one sleeve between two gears, pushed by the shift force.

On its way to a gear the sleeve meets, at rising travel: the blocking position, where the ring holds it
back while the cone synchronises; after that a free flight; the dogs, which lock sleeve and gear; the
end stop.  Friction under the force ``F`` gives the cone the torque capacity
``mu*F*R*n/sin(alpha)``; the driveline decides whether sleeve and gear slip or stick under it, so success
follows from torque against inertia.  The ring lets go only once they stick and the index time is over.

| phase | leaves when |
|---|---|
| NEUTRAL | a gear is requested with enough force: TRAVEL |
| TRAVEL | blocking position: SYNCHRONISING; dogs meet with slip: GRATING; end stop: ENGAGED |
| SYNCHRONISING | cone stuck: INDEX; time-out or force lost: ABORTED |
| INDEX | its time is over: TRAVEL; cone slips or force lost: SYNCHRONISING; time-out: ABORTED |
| GRATING | slip small enough: TRAVEL; time-out: ABORTED |
| ENGAGED | another request: DISENGAGING |
| DISENGAGING | torque holds the dogs: BLOCKED_BY_TORQUE; centre: NEUTRAL; the gear wanted again: TRAVEL |
| BLOCKED_BY_TORQUE | torque gone: DISENGAGING; the gear wanted again: TRAVEL |
| ABORTED | the sleeve is back at the centre and another gear, or none, is requested: NEUTRAL |

A request for another gear turns every phase of engaging into DISENGAGING.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from hev_can_emu.jit import small_kernel
from hev_can_emu.plant import checks
from hev_can_emu.plant import torque_source as source

# Phases; the numbers are those of the control units' ports.
NEUTRAL, TRAVEL, SYNCHRONISING, INDEX, ENGAGED = 0, 1, 2, 3, 4
DISENGAGING, ABORTED, BLOCKED_BY_TORQUE, GRATING = 5, 6, 7, 8

BETWEEN = 3
"""The gear told while the sleeve is neither at the centre nor at an end stop."""

# Layout of the packed parameters.
P_DT, P_MAX_FORCE, P_FORCE_KEEP, P_LEAST_FORCE, P_CENTRING_FORCE = 0, 1, 2, 3, 4
P_DAMPING, P_MAX_VELOCITY, P_BLOCKING, P_DOGS, P_END = 5, 6, 7, 8, 9
P_CONE1, P_CONE2, P_INDEX_TIME, P_TIMEOUT, P_LOST_TIME = 10, 11, 12, 13, 14
P_FREE_SHARE, P_DOG_SLIP, P_DOG_HOLD = 15, 16, 17
N_PARAMETERS = 18

# Layout of the state: phase, sleeve position m, force N (both positive towards G1), gear aimed at,
# time since the ring blocked s, time of index or of missing force s, 1 once past the ring.
X_PHASE, X_POSITION, X_FORCE, X_TARGET, X_SHIFT_TIME, X_WAIT, X_PASSED = 0, 1, 2, 3, 4, 5, 6
N_STATE = 7

# Layout of the output.
OUT_PHASE, OUT_POSITION, OUT_FORCE, OUT_GEAR, OUT_SLIP, OUT_REASON = 0, 1, 2, 3, 4, 5
OUT_CONE1, OUT_CONE2, OUT_DOG1, OUT_DOG2 = 6, 7, 8, 9
N_OUT = 10

_HALF_NS = 5e-10


class SynchronizerParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Sleeve, cones and dogs; SI units.

    Attributes:
        max_force: greatest force on the sleeve, N.
        force_time_constant: of the actuator, s.
        least_force: below it the sleeve does not move (detent), N.
        centring_force: brings the sleeve back from before the dogs without any request, N.
        damping: force above ``least_force`` per velocity, N s/m.
        max_velocity: of the sleeve, m/s.
        blocking_position, dog_position, end_position: travel from the centre, m.
        cone_friction: mu, 1.
        cone_radius: mean radius R, m.
        cone_angle: alpha, half the cone's angle, rad.
        cones_g1, cones_g2: friction surfaces n of each gear, 1.
        index_time: that the ring takes to turn out of the way, s.
        timeout: longest time from blocking to engaging, s.
        lost_force_time: the shift is given up after so long without force, s.
        free_flight_share: share of the cone's capacity left between ring and dogs, 1.
        dog_slip: greatest slip at which the dogs go in, rad/s.
        dog_friction: of the dogs' flanks, 1.
        dog_radius: m.
    """

    max_force: float
    force_time_constant: float
    least_force: float
    centring_force: float
    damping: float
    max_velocity: float
    blocking_position: float
    dog_position: float
    end_position: float
    cone_friction: float
    cone_radius: float
    cone_angle: float
    cones_g1: float
    cones_g2: float
    index_time: float
    timeout: float
    lost_force_time: float
    free_flight_share: float
    dog_slip: float
    dog_friction: float
    dog_radius: float

    def validate(self, where: str) -> None:
        """Raise :class:`hev_can_emu.errors.InputError` naming the first value that makes no sense."""
        checks.positive(where, self, "least_force", "damping", "max_velocity", "timeout")
        checks.ordered(where, self, "least_force", "centring_force")
        checks.ordered(where, self, "least_force", "max_force")
        checks.positive(where, self, "blocking_position", "dog_slip", "dog_radius")
        checks.ordered(where, self, "blocking_position", "dog_position", "end_position")
        names = ("cone_friction", "cone_radius", "cone_angle", "cones_g1", "cones_g2")
        checks.positive(where, self, *names)
        checks.not_negative(
            where, self, "force_time_constant", "index_time", "lost_force_time", "dog_friction"
        )
        checks.fraction(where, self, "free_flight_share")

    def pack(self, dt: float = 1e-3) -> NDArray[np.float64]:
        """Return the kernel's parameters, shape ``(N_PARAMETERS,)``, for a period of ``dt`` s."""
        tau = self.force_time_constant
        cone = self.cone_friction * self.cone_radius / math.sin(self.cone_angle)
        return np.array(
            [
                dt,
                self.max_force,
                math.exp(-dt / tau) if tau > 0.0 else 0.0,
                self.least_force,
                self.centring_force,
                self.damping,
                self.max_velocity,
                self.blocking_position,
                self.dog_position,
                self.end_position,
                cone * self.cones_g1,
                cone * self.cones_g2,
                self.index_time,
                self.timeout,
                self.lost_force_time,
                self.free_flight_share,
                self.dog_slip,
                self.dog_friction / self.dog_radius,
            ]
        )


@small_kernel
def _travel(p: NDArray[np.float64], force: float) -> float:
    """Return the sleeve's travel in one period under a force in its direction, m."""
    velocity: float = (force - p[P_LEAST_FORCE]) / p[P_DAMPING]
    dt: float = p[P_DT]
    fastest: float = p[P_MAX_VELOCITY]
    return min(max(velocity, 0.0), fastest) * dt


@small_kernel
def _choose(x: NDArray[np.float64], gear: float, force: float, least_force: float) -> None:
    """Change phase where the request alone decides it."""
    phase = x[X_PHASE]
    wanted = gear == x[X_TARGET]
    if phase == NEUTRAL:
        if gear != 0.0 and force >= least_force:
            x[X_TARGET] = gear
            x[X_PHASE] = TRAVEL
    elif phase == ABORTED:
        if not wanted and x[X_POSITION] == 0.0:
            x[X_PHASE] = NEUTRAL
            x[X_TARGET] = 0.0
    elif phase in (DISENGAGING, BLOCKED_BY_TORQUE):
        if wanted:
            x[X_PHASE] = TRAVEL
    elif not wanted:
        x[X_PHASE] = DISENGAGING


@small_kernel
def _advance(
    p: NDArray[np.float64], x: NDArray[np.float64], s: float, push: float, slip: float, stuck: float
) -> float:
    """Move the sleeve towards its gear; return the travel ``s`` from the centre, m."""
    phase = x[X_PHASE]
    pushed = push >= p[P_LEAST_FORCE]
    x[X_SHIFT_TIME] += p[P_DT]
    x[X_WAIT] += p[P_DT]
    late = x[X_SHIFT_TIME] >= p[P_TIMEOUT] - _HALF_NS
    if phase == TRAVEL:
        new = s + _travel(p, push)
        if x[X_PASSED] < 0.5:
            if new >= p[P_BLOCKING]:
                new = p[P_BLOCKING]
                x[X_PHASE] = SYNCHRONISING
                x[X_SHIFT_TIME] = 0.0
                x[X_WAIT] = 0.0
        elif s < p[P_DOGS] <= new and abs(slip) > p[P_DOG_SLIP]:
            new = p[P_DOGS]
            x[X_PHASE] = GRATING
        elif new >= p[P_END]:
            new = p[P_END]
            x[X_PHASE] = ENGAGED
        return new
    if phase == SYNCHRONISING:
        if pushed:
            x[X_WAIT] = 0.0
        if stuck > 0.5 and pushed:
            x[X_PHASE] = INDEX
            x[X_WAIT] = 0.0
        elif late or x[X_WAIT] > p[P_LOST_TIME] + _HALF_NS:
            x[X_PHASE] = ABORTED
    elif phase == INDEX:
        if late:
            x[X_PHASE] = ABORTED
        elif stuck < 0.5 or not pushed:
            x[X_PHASE] = SYNCHRONISING
            x[X_WAIT] = 0.0
        elif x[X_WAIT] >= p[P_INDEX_TIME] - _HALF_NS:
            x[X_PHASE] = TRAVEL
            x[X_PASSED] = 1.0
    elif phase == GRATING:
        if late:
            x[X_PHASE] = ABORTED
        elif pushed and abs(slip) <= p[P_DOG_SLIP]:
            x[X_PHASE] = TRAVEL
    return s


@small_kernel
def _return(
    p: NDArray[np.float64], x: NDArray[np.float64], s: float, push: float, dog_torque: float
) -> float:
    """Move the sleeve towards the centre; return the travel ``s`` from it, m."""
    if s > p[P_DOGS]:
        held = abs(dog_torque) * p[P_DOG_HOLD]
        if push >= p[P_LEAST_FORCE] and push <= held:
            x[X_PHASE] = BLOCKED_BY_TORQUE
            return s
        x[X_PHASE] = DISENGAGING
        new = s - _travel(p, push - held)
    else:
        new = s - _travel(p, max(push, p[P_CENTRING_FORCE]))
    if new < p[P_BLOCKING]:
        x[X_PASSED] = 0.0
    if new <= 0.0:
        new = 0.0
        if x[X_PHASE] != ABORTED:
            x[X_PHASE] = NEUTRAL
            x[X_TARGET] = 0.0
    return new


@small_kernel
def synchronizer_step(
    p: NDArray[np.float64],
    x: NDArray[np.float64],
    gear_request: float,
    force_request: float,
    slip1: float,
    slip2: float,
    stuck1: float,
    stuck2: float,
    dog_torque: float,
    out: NDArray[np.float64],
) -> None:
    """Advance one period.

    Args:
        p: parameters, ``(N_PARAMETERS,)``.
        x: state, ``(N_STATE,)``, changed in place; all zero is neutral at rest.
        gear_request: 0 neutral, 1 G1, 2 G2; NaN or anything else: as before.
        force_request: magnitude, N; NaN counts as 0.
        slip1, slip2: sleeve speed minus the speed of each gear, rad/s.
        stuck1, stuck2: 1 where the driveline reports sleeve and gear stuck under the cone's torque.
        dog_torque: that the dogs of the engaged gear carry, N m.
        out: ``(N_OUT,)``: phase; position m and force N, positive towards G1; gear (3: between); slip
            against the gear aimed at, rad/s; LIMIT_* code; cone capacities of G1 and G2 N m; dog locks
            of G1 and G2, 0 or 1 (a fall from 1 to 0 releases the lock).
    """
    gear = x[X_TARGET]
    if gear_request in (0.0, 1.0, 2.0):
        gear = gear_request
    force = 0.0 if math.isnan(force_request) else min(max(force_request, 0.0), p[P_MAX_FORCE])
    _choose(x, gear, force, p[P_LEAST_FORCE])

    target = x[X_TARGET]
    side = 0.0 if target == 0.0 else (1.0 if target == 1.0 else -1.0)
    slip = slip1 if target == 1.0 else (slip2 if target == 2.0 else 0.0)
    stuck = stuck1 if target == 1.0 else stuck2
    phase = x[X_PHASE]
    returning = phase in (DISENGAGING, BLOCKED_BY_TORQUE, ABORTED)
    direction = -side if returning else side
    s = side * x[X_POSITION]
    wanted = direction * force
    if phase == ABORTED and s == 0.0:
        wanted = 0.0
    x[X_FORCE] = wanted + (x[X_FORCE] - wanted) * p[P_FORCE_KEEP]
    push = direction * x[X_FORCE]

    if returning:
        s = _return(p, x, s, push, dog_torque)
    elif phase != NEUTRAL:
        s = _advance(p, x, s, push, slip, stuck)
    x[X_POSITION] = side * s + 0.0  # never a negative zero

    phase = x[X_PHASE]
    cone = 0.0
    if phase in (SYNCHRONISING, INDEX):
        cone = max(push, 0.0)
    elif phase == TRAVEL and x[X_PASSED] > 0.5 and s <= p[P_DOGS]:
        cone = max(push, 0.0) * p[P_FREE_SHARE]
    dog = 1.0 if s > p[P_DOGS] else 0.0
    out[OUT_PHASE] = phase
    out[OUT_POSITION] = x[X_POSITION]
    out[OUT_FORCE] = x[X_FORCE]
    out[OUT_GEAR] = target if phase == ENGAGED else (0.0 if s == 0.0 else float(BETWEEN))
    out[OUT_SLIP] = slip
    out[OUT_REASON] = source.LIMIT_NONE
    if phase == BLOCKED_BY_TORQUE:
        out[OUT_REASON] = source.LIMIT_TORQUE_ON_DOGS
    elif phase == ABORTED:
        out[OUT_REASON] = source.LIMIT_SYNC_TIMEOUT
    out[OUT_CONE1] = p[P_CONE1] * cone if target == 1.0 else 0.0
    out[OUT_CONE2] = p[P_CONE2] * cone if target == 2.0 else 0.0
    out[OUT_DOG1] = dog if target == 1.0 else 0.0
    out[OUT_DOG2] = dog if target == 2.0 else 0.0
