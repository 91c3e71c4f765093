"""A tyre that slips: one front wheel with its share of the body, driven, let go, locked."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

from hev_can_emu.commands._components.card import Car, Card
from hev_can_emu.plant import tyre
from hev_can_emu.plant.road import GRAVITY
from hev_can_emu.report.component_plot import Curve, Fact, Panel

STEP = 5e-5
SUMMER = tyre.TyreSlipParameters(slip_stiffness=22.0, friction=1.0, front_load=0.6)
SPEED = 40.0  # rad/s
_KNOWN = "#22272e"


class Corner:
    """The wheel and its share of the body; spring and damper move exactly, then the patch creeps."""

    def __init__(self, car: Car, held: bool = False, body_held: bool = False) -> None:
        """Start at rest; ``held`` wheel or body keeps its speed."""
        self.slip = car.detailed.tyre_slip or SUMMER
        driveline, radius = car.driveline, car.driveline.tyre_radius
        load = 0.5 * self.slip.front_load * driveline.inertias["Jv"] / radius**2 * GRAVITY
        self.stiffness, self.damping = driveline.stiffness["klw"], driveline.damping["clw"]
        self.limit = self.slip.friction * load * radius
        self.slope = self.slip.slip_stiffness * load * radius
        self.body = load / GRAVITY * radius**2
        wheel = driveline.inertias["Jlw"]
        self.p = self.slip.pack(load, radius, self.stiffness, self.damping, wheel, self.body, STEP)
        self.held = float(held), float(body_held)
        self.state, self.out = np.zeros(3), np.zeros(tyre.N_OUT)
        ease = np.array([0.0 if held else 1.0 / wheel, 0.0 if body_held else 1.0 / self.body])
        rate = np.zeros((5, 5))  # twist, wheel, body; torques on wheel and body
        rate[0, 1:3] = 1.0, -1.0
        pull = np.array([self.stiffness, self.damping, -self.damping])
        rate[1, :3], rate[2, :3] = -ease[0] * pull, ease[1] * pull
        rate[1, 3], rate[2, 4] = ease
        self.flow = expm(rate * STEP)
        self.heat = 0.0

    def run(self, seconds: float, wheel: float = 0.0, body: float = 0.0) -> np.ndarray:
        """Return time s, twist rad, wheel and body speed rad/s, slip speed rad/s, torque N m per step."""
        rows = []
        for k in range(round(seconds / STEP)):
            self.state[:] = (self.flow @ np.array([*self.state, wheel, body]))[:3]
            tyre.tyre_step(self.p, self.state, *self.held, self.out)
            self.heat += self.out[tyre.OUT_SLIP_LOSS]
            told = self.out[tyre.OUT_SLIP], self.out[tyre.OUT_TORQUE]
            rows.append(((k + 1) * STEP, *self.state, *told))
        return np.array(rows)

    def brush(self, slip: np.ndarray | float) -> np.ndarray:
        """Return the brush model's torque as its textbooks write it, N m."""
        x = np.minimum(self.slope * np.abs(slip) / self.limit, 3.0)
        return np.asarray(np.sign(slip) * self.limit * (x - x**2 / 3.0 + x**3 / 27.0))


def steady(car: Car, share: float) -> tuple[float, float]:
    """Return slip and torque, N m, that settle where wheel and body pull apart with a share of the limit."""
    corner = Corner(car)
    corner.state[1:] = SPEED
    torque = share * corner.limit
    last = corner.run(1.0, torque, -torque)[-1]
    return last[4] / abs(last[3]), last[5]


def show(car: Car) -> Card:
    """Compute the card; a car whose file has no ``tyre_slip`` shows a summer tyre."""
    plain = Corner(car)
    shares = np.array([-0.95, -0.7, -0.4, 0.2, 0.5, 0.8, 0.95])
    points = np.array([steady(car, share) for share in shares])
    half = points[shares == 0.5][0]

    released = Corner(car, held=True, body_held=True)
    released.state[:] = 1e-4, SPEED, SPEED
    run_off = released.run(0.15)
    rate = released.stiffness / (released.slope / SPEED + released.damping)
    slope = float(np.polyfit(run_off[200:, 0], np.log(run_off[200:, 1]), 1)[0])

    locked = Corner(car, held=True)
    locked.state[2] = SPEED
    start = 0.5 * locked.body * SPEED**2
    pull = locked.limit / locked.body
    stop = locked.run(1.3 * SPEED / pull)
    inside = (stop[:, 0] > 0.3 * SPEED / pull) & (stop[:, 0] < 0.8 * SPEED / pull)
    fall = float(np.polyfit(stop[inside, 0], stop[inside, 3], 1)[0])
    left = 0.5 * (locked.body * stop[-1, 3] ** 2 + locked.stiffness * stop[-1, 1] ** 2)

    parked = Corner(car, held=True, body_held=True)
    parked.state[0] = 0.9 * parked.limit / parked.stiffness
    wound = parked.state[0]
    crept = float(wound - parked.run(1.0)[-1, 1])

    radius = car.driveline.tyre_radius
    facts = [
        Fact("steady slip at half the limit: brush model's torque", "N m",
             float(plain.brush(half[0])), half[1], 1e-3),
        Fact("a small twist runs off with k/(C/w + c)", "1/s", -rate, slope, 5e-3),
        Fact("locked wheel: deceleration mu g", "m/s^2",
             -plain.slip.friction * GRAVITY, fall * radius, 5e-3),
        Fact("locked wheel: heat of the stop", "J", start - left, locked.heat, 0.02),
        Fact("parked at 0.9 of the limit: twist that creeps away in a second", "rad", 0.0, crept, 0.0),
    ]  # fmt: skip
    reach = 1.2 * 3.0 * plain.limit / plain.slope
    slips = np.linspace(-reach, reach, 200)
    time = np.linspace(0.0, 0.15, 100)
    panels = [
        Panel("Torque over slip", "slip (%)", "torque (N m)", [
            Curve("known: brush model", 100 * slips, plain.brush(slips), True, color=_KNOWN),
            Curve("settled", 100 * points[:, 0], points[:, 1], marker="o"),
        ]),
        Panel(f"Twist let go at {SPEED * radius * 3.6:.0f} km/h", "time (ms)", "mrad", [
            Curve("computed", 1e3 * run_off[::20, 0], 1e3 * run_off[::20, 1]),
            Curve("known", 1e3 * time, 0.1 * np.exp(-rate * time), True, color=_KNOWN),
        ]),
        Panel("Wheel locked", "time (s)", "speed (m/s)", [
            Curve("body", stop[::100, 0], radius * stop[::100, 3]),
            Curve("known: mu g", np.array([0.0, SPEED / pull]), np.array([radius * SPEED, 0.0]), True,
                  color=_KNOWN),
        ]),
    ]  # fmt: skip
    note = "" if car.detailed.tyre_slip else "summer tyre: the vehicle file has no tyre_slip"
    return Card("Tyre slip", panels, facts, note)
