"""What the sleeve of the detailed synchronizer is made of, and the layout of its packed parameters."""

from __future__ import annotations

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from hev_can_emu.errors import InputError
from hev_can_emu.plant import checks

# Layout of the packed parameters.
P_DT, P_MASS, P_DAMPING, P_GUIDE_FRICTION = 0, 1, 2, 3
P_NEUTRAL_FORCE, P_NEUTRAL_WIDTH = 4, 5
P_ENGAGED_FORCE, P_ENGAGED_WIDTH = 6, 7
P_STRUT_FORCE, P_STRUT = 8, 9
P_BLOCKING, P_TIP, P_DOGS, P_OVERLAP, P_END = 10, 11, 12, 13, 14
P_CONE1, P_CONE2 = 15, 16
P_INDEX_RATE, P_FLIGHT_SHARE = 17, 18
P_PITCH, P_HALF, P_SLOPE = 19, 20, 21
P_FACE_DRAG, P_GRATING_DRAG, P_DOG_HOLD = 22, 23, 24
P_DOG_SLIP, P_RATCHET, P_RATCHET_MAX = 25, 26, 27
P_INDEX_LEVER, P_STIFFNESS, P_EASE = 28, 29, 30
N_PARAMETERS = 31

# How light the turning parts are taken to be behind the chamfers: the sleeve's mass is so many times theirs.
_LIGHTEST = 4.0


class SleeveParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Sleeve, detents, rings, cones and dogs; SI units, travel counted from the centre.

    Attributes:
        mass: of all that moves with the sleeve (fork, rod, piston), kg.
        damping: viscous, of guide and seals, N s/m.
        guide_friction: dry, of guide and seals, N.
        neutral_force, neutral_width: greatest force of the notch at the centre, N; its half width, m.
        engaged_force, engaged_width: of the notch at each end, N; its width towards the centre, m.
        strut_force: greatest force with which the struts press the ring before it blocks, N.
        strut_position: where they begin to, m.
        blocking_position: where the ring blocks, m.
        dog_position: where the dogs, past their chamfers, begin to overlap, m.
        chamfer_depth: by which the dogs' tips stand before that, m.
        least_overlap: of the dogs from which they count as engaged, m.
        end_position: end stop, m.
        cone_friction: mu, 1.
        cone_radius: mean radius R, m.
        cone_angle: alpha, half the cone's angle, rad.
        cones_g1, cones_g2: friction surfaces n of each gear, 1.
        ring_chamfer_angle: of the ring's blocking chamfers against the axis, rad.
        chamfer_friction: of ring and dog chamfers, 1.
        index_time: that the ring takes to turn out of the way, s, under
        index_force: N.
        flight_share: share of the force that still rubs at the ring between ring and dogs, 1.
        dog_teeth: number of dogs around.
        dog_radius: m.
        half_clearance: half the dogs' play, rad.
        dog_slip: greatest slip at which the dogs go in, rad/s.
        dog_friction: of the dogs' flanks and tips, 1.
        ratchet_share: speed at which grating dogs throw the sleeve back, as a share of theirs, 1.
        ratchet_speed: greatest such speed, m/s.
    """

    mass: float
    damping: float
    guide_friction: float
    neutral_force: float
    neutral_width: float
    engaged_force: float
    engaged_width: float
    strut_force: float
    strut_position: float
    blocking_position: float
    dog_position: float
    chamfer_depth: float
    least_overlap: float
    end_position: float
    cone_friction: float
    cone_radius: float
    cone_angle: float
    cones_g1: float
    cones_g2: float
    ring_chamfer_angle: float
    chamfer_friction: float
    index_time: float
    index_force: float
    flight_share: float
    dog_teeth: int
    dog_radius: float
    half_clearance: float
    dog_slip: float
    dog_friction: float
    ratchet_share: float
    ratchet_speed: float

    @property
    def tip_position(self) -> float:
        """Travel at which the dogs' tips meet, m."""
        return self.dog_position - self.chamfer_depth

    @property
    def pitch(self) -> float:
        """Angle from dog to dog, rad."""
        return 2.0 * math.pi / self.dog_teeth

    @property
    def chamfer_slope(self) -> float:
        """Travel per angle along the dogs' chamfers, m/rad."""
        return self.chamfer_depth / (0.5 * self.pitch - self.half_clearance)

    @property
    def index_lever(self) -> float:
        """Torque per force with which the blocking chamfers turn the ring, m."""
        steep, mu = math.tan(self.ring_chamfer_angle), self.chamfer_friction
        return self.dog_radius * (1.0 - mu * steep) / (steep + mu)

    def cone_lever(self, gear: int) -> float:
        """Return the torque per force of a gear's cones, ``mu*R*n/sin(alpha)``, m."""
        surfaces = self.cones_g1 if gear == 1 else self.cones_g2
        return self.cone_friction * self.cone_radius * surfaces / math.sin(self.cone_angle)

    def validate(self, where: str) -> None:
        """Raise :class:`hev_can_emu.errors.InputError` naming the first value that makes no sense."""
        checks.positive(where, self, "mass", "neutral_width", "engaged_width", "chamfer_depth")
        checks.not_negative(where, self, "damping", "guide_friction", "neutral_force")
        checks.not_negative(where, self, "engaged_force", "strut_force", "chamfer_friction")
        checks.ordered(where, self, "neutral_width", "strut_position", "blocking_position")
        checks.ordered(where, self, "blocking_position", "tip_position", "dog_position")
        checks.ordered(where, self, "dog_position", "end_position")
        checks.positive(where, self, "least_overlap", "cone_friction", "cone_radius", "cone_angle")
        checks.positive(where, self, "cones_g1", "cones_g2", "ring_chamfer_angle", "index_time")
        checks.positive(where, self, "index_force", "dog_radius", "half_clearance", "dog_slip")
        checks.not_negative(where, self, "dog_friction", "ratchet_share", "ratchet_speed")
        checks.fraction(where, self, "flight_share")
        room = self.end_position - self.dog_position
        for name in ("least_overlap", "engaged_width"):
            if getattr(self, name) >= room:
                expected = f"less than the way from dogs to end stop ({room:g} m)"
                raise InputError(f"{where}.{name}", expected, f"{getattr(self, name):g}")
        for name in ("cone_angle", "ring_chamfer_angle"):
            if getattr(self, name) >= 0.5 * math.pi:
                raise InputError(f"{where}.{name}", "less than pi/2", f"{getattr(self, name):g}")
        if self.dog_teeth < 2:
            raise InputError(f"{where}.dog_teeth", "at least 2", str(self.dog_teeth))
        if 2.0 * self.half_clearance >= 0.5 * self.pitch:
            expected = f"less than a quarter of the pitch ({0.25 * self.pitch:g} rad)"
            raise InputError(f"{where}.half_clearance", expected, f"{self.half_clearance:g}")
        weakest = min(self.cone_lever(1), self.cone_lever(2))
        if self.index_lever >= weakest:
            raise InputError(
                f"{where}.ring_chamfer_angle",
                f"so large that the ring turns with less than the cones' {weakest:.4g} m of lever",
                f"{self.index_lever:.4g} m",
                "otherwise the ring lets go while it still slips",
            )

    def pack(self, dt: float = 5e-5) -> NDArray[np.float64]:
        """Return the kernel's parameters, shape ``(N_PARAMETERS,)``, for a step of ``dt`` s."""
        slope = self.chamfer_slope
        # Frictionless lever of the chamfers is the slope; friction takes mu of the normal force.
        normal = self.dog_radius * (1.0 + (slope / self.dog_radius) ** 2)
        steepest = max(
            self.neutral_force / self.neutral_width,
            self.engaged_force / self.engaged_width,
            self.strut_force / (self.blocking_position - self.strut_position),
        )
        return np.array(
            [
                dt,
                self.mass,
                self.damping,
                self.guide_friction,
                self.neutral_force,
                self.neutral_width,
                self.engaged_force,
                self.engaged_width,
                self.strut_force,
                self.strut_position,
                self.blocking_position,
                self.tip_position,
                self.dog_position,
                self.least_overlap,
                self.end_position,
                self.cone_lever(1),
                self.cone_lever(2),
                1.0 / (self.index_time * self.index_force),
                self.flight_share,
                self.pitch,
                self.half_clearance,
                slope,
                self.chamfer_friction * normal,
                self.dog_friction * self.dog_radius,
                self.dog_friction / self.dog_radius,
                self.dog_slip,
                self.ratchet_share * self.dog_radius,
                self.ratchet_speed,
                self.index_lever,
                4.0 * steepest,
                _LIGHTEST / self.mass,
            ]
        )
