"""The TCU's shift control for the detailed synchronizer: which way to push, and how hard.

First the layouts.
"""

from __future__ import annotations

import msgspec
import numpy as np
from numpy.typing import NDArray

from hev_can_emu.jit import kernel
from hev_can_emu.plant import checks

# Phases, as the simple synchronizer's and as told.
NEUTRAL, TRAVEL, SYNCHRONISING, INDEX, ENGAGED = 0, 1, 2, 3, 4
DISENGAGING, ABORTED, BLOCKED_BY_TORQUE, GRATING = 5, 6, 7, 8

BETWEEN = 3
"""The gear told while the sleeve is neither at the centre nor in a gear."""

# Layout of the packed parameters.
P_DT, P_MAX_FORCE, P_LEAST_FORCE, P_TRAVEL_FORCE, P_DOG_FORCE = 0, 1, 2, 3, 4
P_HOLDING_FORCE, P_HOLDING_TIME, P_CENTRING_FORCE = 5, 6, 7
P_CENTRING_STIFFNESS, P_CENTRING_DAMPING, P_CENTRE_BAND, P_SPEED_SHARE = 8, 9, 10, 11
P_TIMEOUT, P_LOST_TIME, P_STILL_TIME, P_STILL_SPEED = 12, 13, 14, 15
N_PARAMETERS = 16

# Layout of the state: phase, gear aimed at, time since the ring blocked s, time without force or of
# standing or of holding s, position last seen m, filtered velocity m/s, time at the centre s.
X_PHASE, X_TARGET, X_SHIFT_TIME, X_WAIT, X_POSITION, X_SPEED, X_SETTLED = 0, 1, 2, 3, 4, 5, 6
N_STATE = 7

# Layout of the output: force request N, positive towards G1; phase; gear aimed at; gear told;
# slip against the gear aimed at, rad/s; LIMIT_* code.
OUT_FORCE, OUT_PHASE, OUT_TARGET, OUT_GEAR, OUT_SLIP, OUT_REASON = 0, 1, 2, 3, 4, 5
N_OUT = 6


class ShiftControlParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Forces and times; SI units.

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

    max_force: float
    least_force: float
    travel_force: float
    dog_force: float
    holding_force: float
    holding_time: float
    centring_force: float
    centring_stiffness: float
    centring_damping: float
    centre_band: float
    speed_time: float
    timeout: float
    lost_force_time: float
    still_time: float
    still_speed: float

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
def shift_control_step(
    p: NDArray[np.float64],
    x: NDArray[np.float64],
    gear_request: float,
    force_request: float,
    position: float,
    slip1: float,
    slip2: float,
    zone: float,
    held1: float,
    held2: float,
    torque: float,
    out: NDArray[np.float64],
) -> None:
    """Act once per control period.

    Args:
        p: parameters, ``(N_PARAMETERS,)``.
        x: state, ``(N_STATE,)``, changed in place; all zero is neutral at rest.
        gear_request: 0 neutral, 1 G1, 2 G2; NaN or anything else: as before.
        force_request: magnitude, N; NaN counts as 0.
        position: of the sleeve, m, positive towards G1.
        slip1, slip2: sleeve speed minus the speed of each gear, rad/s.
        zone: of :mod:`hev_can_emu.plant.sleeve`.
        held1, held2: 1 where the driveline holds sleeve and gear.
        torque: that the dogs of the engaged gear carry, N m.
        out: ``(N_OUT,)``: force request N, positive towards G1; phase; gear aimed at; gear told (3:
            between); slip against the gear aimed at, rad/s; LIMIT_* code.
    """
    out[:] = 0.0
    out[OUT_PHASE] = x[X_PHASE]
