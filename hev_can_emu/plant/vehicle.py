"""Driveline parameters in SI, checked."""

from __future__ import annotations

import msgspec

from hev_can_emu.errors import InputError, did_you_mean

INERTIA_NAMES = (
    "Je", "Jc1", "Jc2", "Jm1", "Jid", "J1", "Jm2", "J2", "Jsleeve",
    "Jg11", "Jg12", "Jfd1", "Jg22", "Jg21", "Jfd2", "Jlw", "Jrw", "Jv",
)  # fmt: skip
SHAFTS = ("1", "2", "3", "4", "5", "6", "lh", "rh", "lw", "rw")
MESHES = ("m1", "id", "m2", "g1", "g2", "fd")
RADIUS_NAMES = ("rm1", "rid", "r1", "rm2", "r2", "rg11", "rg12", "rg21", "rg22", "rfd1", "rfd2")
RATIO_RADII = {
    "id1": ("rid", "rm1"),
    "id2": ("r1", "rid"),
    "m2": ("r2", "rm2"),
    "g1": ("rg12", "rg11"),
    "g2": ("rg22", "rg21"),
    "fd": ("rfd2", "rfd1"),
}
RATIO_TOLERANCE = 1e-3
"""How far a reduced model's rounded ratio may be from that of the base radii, relative."""
PLAUSIBLE: dict[str, tuple[float, float]] = {
    "inertias": (1e-9, 1e6),
    "stiffness": (1e-3, 1e13),
    "damping": (1e-12, 1e9),
    "base_radii": (1e-4, 10.0),
    "reduced_ratios": (1e-3, 1e3),
}
"""Beyond these, SI, no car's value lies, and arithmetic would break rather than answer."""
SECTIONS: dict[str, tuple[str, ...]] = {
    "inertias": INERTIA_NAMES,
    "stiffness": tuple("k" + name for name in (*SHAFTS, *MESHES)),
    "damping": tuple("c" + name for name in (*SHAFTS, *MESHES)),
    "base_radii": RADIUS_NAMES,
    "reduced_ratios": tuple(RATIO_RADII),
}


class DrivelineParameters(msgspec.Struct, frozen=True):
    """What the torsional model needs, in SI.

    Attributes:
        inertias: kg m^2, keys :data:`INERTIA_NAMES`.
        stiffness: ``k1 .. krw`` N m/rad for shafts, ``km1 .. kfd`` N/m along the line of action.
        damping: ``c1 .. crw`` N m s/rad, ``cm1 .. cfd`` N s/m.
        base_radii: m, keys :data:`RADIUS_NAMES`.
        reduced_ratios: ratios the paper's reduced model uses, keys of :data:`RATIO_RADII`.
        tyre_radius: m, from wheel speed to vehicle speed.
    """

    inertias: dict[str, float]
    stiffness: dict[str, float]
    damping: dict[str, float]
    base_radii: dict[str, float]
    reduced_ratios: dict[str, float]
    tyre_radius: float

    @property
    def ratios(self) -> dict[str, float]:
        """Gear ratios that follow from the base radii."""
        return {
            name: self.base_radii[driven] / self.base_radii[driving]
            for name, (driven, driving) in RATIO_RADII.items()
        }

    def check(self, where: str) -> None:
        """Raise InputError for a missing, unknown or impossible value, named by its path."""
        self.check_known(where)
        self.check_possible(where)

    def check_known(self, where: str) -> None:
        """Raise InputError where a name is unknown or a value is missing (ratios may be)."""
        for section, names in SECTIONS.items():
            given: dict[str, float] = getattr(self, section)
            for name in given:
                if name not in names:
                    raise InputError(
                        f"{where}.{section}",
                        f"one of {', '.join(names)}",
                        f"'{name}'",
                        did_you_mean(name, names),
                    )
            for name in names:
                if name not in given and section != "reduced_ratios":
                    raise InputError(f"{where}.{section}.{name}", "a value", "nothing")

    def check_possible(self, where: str) -> None:
        """Raise InputError for a value that no driveline can have."""
        for section, names in SECTIONS.items():
            given: dict[str, float] = getattr(self, section)
            # A lossless branch is a legitimate thought experiment; a massless or limp one is not.
            bound = ">= 0" if section == "damping" else "> 0"
            low, high = PLAUSIBLE[section]
            for name in names:
                value = given[name]
                if value < 0.0 or (value == 0.0 and section != "damping"):
                    raise InputError(f"{where}.{section}.{name}", f"a value {bound}", f"{value:g}")
                if value and not low <= value <= high:
                    raise InputError(
                        f"{where}.{section}.{name}",
                        f"{low:g} to {high:g} in SI units",
                        f"{value:g}",
                        "is the unit right?",
                    )
        if not self.tyre_radius > 0.0:
            raise InputError(f"{where}.tyre_radius", "a value > 0", f"{self.tyre_radius:g}")
        for name, ratio in self.ratios.items():
            if abs(self.reduced_ratios[name] / ratio - 1.0) > RATIO_TOLERANCE:
                driven, driving = RATIO_RADII[name]
                raise InputError(
                    f"{where}.reduced_ratios.{name}",
                    f"{ratio:.6g} = {driven}/{driving} within {RATIO_TOLERANCE:g} relative",
                    f"{self.reduced_ratios[name]:g}",
                    "correct the ratio or the base radii",
                )
