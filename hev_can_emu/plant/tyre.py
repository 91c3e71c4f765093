"""Tyre slip: what of a tyre's twist runs off over the road.

The tyre of the driveline is a spring and a damper between wheel and body.  In series with them the
contact patch creeps: ``q' = w_wheel - w_body - w_slip`` and ``T = k*q + c*q'``.  The slip is that of the
brush model, ``T/T_max = 1 - (1 - C*s/(3*T_max))^3`` for ``s = w_slip/|w_body|`` up to ``3*T_max/C``, and
beyond it whatever keeps the torque at ``T_max = mu*N*r``.  At standstill nothing creeps below that, so
a car that stands on a hill stays there.

The driveline's step knows no slip.  After it, :func:`tyre_step` lets the patch creep over the same time, by
the mean torque of the step (implicit; order 1): twist runs off, and what the damper would have
carried of the creep is given back to wheel and body.  Slip heat and the damper's correction are exactly
the energy that goes.  Between the two the driveline sees a damper that knows no slip; what that asks too
much of a held wheel's brake, or tells too much of the body, :func:`allow_for_creep` and
:func:`creep_torque` take away.
"""

from __future__ import annotations

from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from hev_can_emu.errors import InputError
from hev_can_emu.jit import kernel
from hev_can_emu.plant import checks
from hev_can_emu.plant.road import GRAVITY
from hev_can_emu.plant.structure import BODY, LEFT, REAR, RIGHT, Structure

# Layout of the packed parameters.
P_DT, P_STIFFNESS, P_DAMPING, P_SLIP_STIFFNESS, P_LIMIT = 0, 1, 2, 3, 4
P_WHEEL_INERTIA, P_BODY_INERTIA = 5, 6
N_PARAMETERS = 7

# Layout of the output: slip speed rad/s, torque N m, then J in this step.
OUT_SLIP, OUT_TORQUE, OUT_SLIP_LOSS, OUT_DAMPER_CHANGE = 0, 1, 2, 3
N_OUT = 4

N_TYRES = 3  #: at most: front left, front right, both rear ones
WORK = 3 + N_OUT  #: scratch of :func:`slip_tyres`

_ROUNDS = 60


class TyreSlipParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Slip of the tyres; all are alike.

    Attributes:
        slip_stiffness: longitudinal force over slip at small slip, as a share of the load, 1.
        friction: greatest longitudinal force over load, mu, 1.
        front_load: share of the weight on the front axle, 1.
    """

    slip_stiffness: float
    friction: float
    front_load: float

    def validate(self, where: str) -> None:
        """Raise :class:`hev_can_emu.errors.InputError` naming the first value that makes no sense."""
        checks.positive(where, self, "slip_stiffness", "friction")
        checks.finite(where, self, "front_load")
        if not 0.0 < self.front_load < 1.0:  # an axle without load has no slip law
            raise InputError(f"{where}.front_load", "between 0 and 1", f"{self.front_load:g}")

    def pack(
        self,
        load: float,
        radius: float,
        stiffness: float,
        damping: float,
        wheel_inertia: float,
        body_inertia: float,
        dt: float = 5e-5,
    ) -> NDArray[np.float64]:
        """Return the kernel's parameters, shape ``(N_PARAMETERS,)``.

        Args:
            load: of the tyre, N.
            radius: m.
            stiffness, damping: of its branch of the driveline, N m/rad and N m s/rad.
            wheel_inertia, body_inertia: of the branch's ends, kg m^2.
            dt: inner step, s.
        """
        grip = load * radius
        return np.array(
            [
                dt,
                stiffness,
                damping,
                self.slip_stiffness * grip,
                self.friction * grip,
                wheel_inertia,
                body_inertia,
            ]
        )


@kernel
def slip_share(torque: float, slip_stiffness: float, limit: float) -> float:
    """Return the slip over rolling speed at a torque within ``limit``: the brush model, inverted."""
    left = max(1.0 - abs(torque) / limit, 0.0)
    size = 3.0 * limit / slip_stiffness * (1.0 - left ** (1.0 / 3.0))
    return float(size if torque >= 0.0 else -size)


@kernel
def tyre_step(
    p: NDArray[np.float64],
    state: NDArray[np.float64],
    wheel_held: float,
    body_held: float,
    out: NDArray[np.float64],
) -> None:
    """Let the contact patch creep over the step that the driveline has just made.

    Args:
        p: parameters, ``(N_PARAMETERS,)``.
        state: twist rad, wheel and body speed rad/s, ``(3,)``, changed in place.
        wheel_held, body_held: 1 where a brake, or rest, holds that end: its speed stays.
        out: ``(N_OUT,)``.
    """
    dt, k, c = p[P_DT], p[P_STIFFNESS], p[P_DAMPING]
    twist, wheel, body = state[0], state[1], state[2]
    ease_wheel = 0.0 if wheel_held > 0.5 else 1.0 / p[P_WHEEL_INERTIA]
    ease_body = 0.0 if body_held > 0.5 else 1.0 / p[P_BODY_INERTIA]
    rate = wheel - body
    # Torque in the middle of the creep, which is the mean of the whole step; falls by ``give`` per slip
    # speed.  Without a damper that would swing for ever: then at the end.
    free = k * twist + c * rate
    late = 1.0 - 0.5 * c / (c + k * dt)
    give = late * k * dt + c - c * c * dt * (ease_wheel + ease_body)
    limit = p[P_LIMIT]
    roll = abs(body)
    size = abs(free)
    if size == 0.0 or (roll == 0.0 and size <= limit):
        out[OUT_SLIP], out[OUT_TORQUE] = 0.0, free
        out[OUT_SLIP_LOSS] = out[OUT_DAMPER_CHANGE] = 0.0
        return
    # With z = (1 - T/T_max)^(1/3), slip = reach*(1 - z): a cubic in z that rises from 0 to 1.
    reach = 3.0 * limit / p[P_SLIP_STIFFNESS] * roll
    slip = (size - limit) / give
    if slip < reach:
        low, high = 0.0, 1.0
        z = 1.0
        for _ in range(_ROUNDS):
            value = size - give * reach * (1.0 - z) - limit * (1.0 - z * z * z)
            if value > 0.0:
                high = z
            else:
                low = z
            slope = give * reach + 3.0 * limit * z * z
            new = z - value / slope
            close = abs(new - z) <= 1e-16 + 1e-15 * abs(z)
            # A root met to the last bit lies on the bracket's edge: that is no reason to halve it.
            if not (close or low < new < high):
                new = 0.5 * (low + high)
            z = new
            if close:
                break
        slip = reach * (1.0 - z)
    if free < 0.0:
        slip = -slip
    crept = slip * dt
    state[0] = twist - crept
    state[1] = wheel + c * crept * ease_wheel
    state[2] = body - c * crept * ease_body
    mean_twist = twist - 0.5 * crept
    mean_rate = rate + 0.5 * c * crept * (ease_wheel + ease_body)
    out[OUT_SLIP], out[OUT_TORQUE] = slip, free - give * slip
    out[OUT_SLIP_LOSS] = (k * mean_twist + c * (mean_rate - slip)) * crept
    out[OUT_DAMPER_CHANGE] = -c * crept * (2.0 * mean_rate - slip)


class TyreSlip(NamedTuple):
    """Constants of a driveline's k slipping tyres.

    Attributes:
        parameters: shape (k, N_PARAMETERS).
        places: shape (k, 5): among the states that of the twist, of the wheel's and of the body's speed; the
            wheel's lock; the branch.
    """

    parameters: NDArray[np.float64]
    places: NDArray[np.int64]


# Branch, wheel, lock; the last one exists only where the rear wheels are an inertia of their own.
_TYRES = (("klw", "Jlw", LEFT), ("krw", "Jrw", RIGHT), ("krear", "Jrear", REAR))


def build_tyre_slip(
    structure: Structure, slip: TyreSlipParameters | None, radius: float, dt: float = 5e-5
) -> TyreSlip | None:
    """Return the constants for a driveline whose twists are all states; None where no tyre slips.

    The loads are those of the car at rest on a level road.
    """
    if slip is None:
        return None
    rows, places = [], []
    body = structure.names.index("Jv")
    weight = structure.inertia[body] / radius**2 * GRAVITY
    for branch, wheel, lock in _TYRES:
        if branch not in structure.branch_names:
            continue
        at, wheel_at = structure.branch_names.index(branch), structure.names.index(wheel)
        share = 1.0 - slip.front_load if lock == REAR else 0.5 * slip.front_load
        rows.append(
            slip.pack(
                share * weight, radius, structure.stiffness[0, at, at],
                structure.damping[0, at, at], structure.inertia[wheel_at], structure.inertia[body], dt,
            )
        )  # fmt: skip
        places.append((structure.n + at, wheel_at, body, lock, at))
    return TyreSlip(np.array(rows), np.array(places, dtype=np.int64))


@kernel
def slip_tyres(
    tyres: TyreSlip,
    x: NDArray[np.float64],
    held: NDArray[np.int64],
    dampers: NDArray[np.float64],
    slips: NDArray[np.float64],
    work: NDArray[np.float64],
) -> float:
    """Let all tyres creep after a step of the driveline; return the slip heat, J.

    Args:
        tyres: constants.
        x: the driveline's state, changed in place.
        held: whether each lock holds.
        dampers: heat of each branch's damper, J; corrected in place; empty where it is not booked.
        slips: slip speed of each tyre, rad/s; written.
        work: scratch, at least ``WORK``.
    """
    state, out = work[:3], work[3 : 3 + N_OUT]
    parameters, places = tyres.parameters, tyres.places
    heat = 0.0
    for i in range(places.shape[0]):
        for j in range(3):
            state[j] = x[places[i, j]]
        tyre_step(parameters[i], state, float(held[places[i, 3]]), float(held[BODY]), out)
        slips[i] = out[OUT_SLIP]
        if out[OUT_SLIP] == 0.0:
            continue
        for j in range(3):
            x[places[i, j]] = state[j]
        heat += out[OUT_SLIP_LOSS]
        if dampers.shape[0] > 0:
            dampers[places[i, 4]] += out[OUT_DAMPER_CHANGE]
    return heat


@kernel
def allow_for_creep(
    tyres: TyreSlip | None, slips: NDArray[np.float64], static: NDArray[np.float64]
) -> None:
    """Let held wheels hold against the torque that the driveline sees for want of slip and no tyre gives.

    Args:
        tyres: constants, or None: nothing to do.
        slips: of the step before, rad/s.
        static: holding capacity of each lock, N m; raised in place where a brake is applied.
    """
    if tyres is not None:
        for i in range(tyres.places.shape[0]):
            p, lock = tyres.parameters[i], tyres.places[i, 3]
            if static[lock] > 0.0:
                static[lock] += (p[P_DAMPING] + p[P_STIFFNESS] * p[P_DT]) * abs(slips[i])


@kernel
def creep_torque(tyres: TyreSlip, slips: NDArray[np.float64]) -> float:
    """Return what the tyres seem to give the body by the state after a step, less what they gave, N m."""
    total = 0.0
    for i in range(tyres.parameters.shape[0]):
        p = tyres.parameters[i]
        damping, spring = p[P_DAMPING], p[P_STIFFNESS] * p[P_DT]
        total += damping * (1.0 - 0.5 * spring / (damping + spring)) * slips[i]
    return total
