"""The detailed driveline: the full order, the rear wheels as an inertia of their own, every twist a state.

The full-order model counts the rear wheels to the body.  Here they turn behind their own tyres, with an
inertia that is taken out of Jv, so that they can be braked to a standstill and spring back.  All
branches keep their twist as a state, also those that others determine: a tyre that creeps, or teeth that
part, leave the sum around the loop of half shafts and tyres free.
"""

from __future__ import annotations

import msgspec
import numpy as np

from hev_can_emu.errors import InputError
from hev_can_emu.plant import checks
from hev_can_emu.plant.structure import Structure, full_order
from hev_can_emu.plant.vehicle import DrivelineParameters

REAR_INERTIA, REAR_BRANCH = "Jrear", "krear"


class RearAxle(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Both rear wheels together, at the wheels' axis; SI units.

    Attributes:
        inertia: kg m^2, taken out of Jv.
        stiffness: of both tyres, wheels to body, N m/rad.
        damping: alike, N m s/rad.
    """

    inertia: float
    stiffness: float
    damping: float

    def validate(self, where: str) -> None:
        """Raise :class:`InputError` naming the first value that makes no sense."""
        checks.positive(where, self, "inertia", "stiffness")
        checks.not_negative(where, self, "damping")

    def check_fits(self, body_inertia: float, where: str) -> None:
        """Raise :class:`InputError` if the wheels are more than the body they are taken out of."""
        if self.inertia >= body_inertia:
            raise InputError(
                f"{where}.inertia", f"less than Jv ({body_inertia:g} kg m^2)", f"{self.inertia:g}"
            )


def geared(parameters: DrivelineParameters, rear: RearAxle | None) -> Structure:
    """Return the detailed driveline: 19 inertias, 17 branches, 7 locks, all twists independent.

    Without ``rear``: 18, 16 and 6, the rear wheels being part of the body.
    """
    full = full_order(parameters)
    if rear is None:
        nb = len(full.branch_names)
        return msgspec.structs.replace(
            full,
            model="detailed",
            basis=np.eye(nb),
            independent=tuple(range(nb)),
            twist_remap=np.broadcast_to(np.eye(nb), (6, 6, nb, nb)).copy(),
        )
    n, nb = full.n + 1, len(full.branch_names) + 1
    body = full.names.index("Jv")
    inertia = np.append(full.inertia, rear.inertia)
    inertia[body] -= rear.inertia
    incidence = np.zeros((nb, n))
    incidence[:-1, :-1] = full.incidence
    incidence[-1, -1], incidence[-1, body] = 1.0, -1.0
    stiffness, damping = np.zeros((6, nb, nb)), np.zeros((6, nb, nb))
    stiffness[:, :-1, :-1], damping[:, :-1, :-1] = full.stiffness, full.damping
    stiffness[:, -1, -1], damping[:, -1, -1] = rear.stiffness, rear.damping
    locks = np.zeros((len(full.locks) + 1, n))
    locks[:-1, :-1] = full.locks
    locks[-1, -1] = 1.0
    ports = np.zeros((len(full.ports), n))
    ports[:, :-1] = full.ports
    return msgspec.structs.replace(
        full,
        model="detailed",
        names=(*full.names, REAR_INERTIA),
        inertia=inertia,
        incidence=incidence,
        branch_names=(*full.branch_names, REAR_BRANCH),
        stiffness=stiffness,
        damping=damping,
        basis=np.eye(nb),
        independent=tuple(range(nb)),
        ports=ports,
        locks=locks,
        twist_remap=np.broadcast_to(np.eye(nb), (6, 6, nb, nb)).copy(),
    )
