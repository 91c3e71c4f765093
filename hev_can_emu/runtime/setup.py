"""What a run consists of: car, network, ownership of nodes; read from files and checked."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import msgspec

from hev_can_emu import config
from hev_can_emu.ecu.bindings_file import Bindings
from hev_can_emu.ecu.faults import Fault, parse
from hev_can_emu.errors import InputError, did_you_mean
from hev_can_emu.plant.reduction import REDUCTIONS
from hev_can_emu.resources import folder, shipped_or_path

if TYPE_CHECKING:
    from hev_can_emu.ecu.transmission_file import CarFile
    from hev_can_emu.plant.machines import Machines
    from hev_can_emu.plant.vehicle import DrivelineParameters

MODELS = ("4dof", "16dof", "detailed")  #: of the plant
PROTECTION_MODES = ("off", "observe", "enforce")
OWNERS = ("emulated", "external", "silent")
STARTS = ("ready", "off")
DEFAULT_VEHICLE = "dai2024"


class Setup(msgspec.Struct, frozen=True, kw_only=True):
    """Everything that decides how an emulator behaves; all of it has a default.

    Attributes:
        vehicle: name of a shipped vehicle, or a file.
        model: one of MODELS.
        reduction: how ``4dof`` is reduced, one of REDUCTIONS.
        dbc: network file; None for the shipped one.
        bindings: what its signals mean; None for the shipped ones.
        protection: what is done with counters and CRCs of received frames.
        start: ``ready``: ignition on, booted, contactors closed; ``off``: everything asleep.
        nodes: owner per node name, where it differs from the bindings' default.
        state_of_charge: at the start, 0 to 1.
        faults: file of faults that a control message injects by number; None for the shipped one, or
            none where the network is not the shipped one.
    """

    vehicle: str = DEFAULT_VEHICLE
    model: str = "16dof"
    reduction: str = "load-weighted"
    dbc: str | None = None
    bindings: str | None = None
    protection: str = "enforce"
    start: str = "ready"
    nodes: Mapping[str, str] = {}
    state_of_charge: float = 0.6
    faults: str | None = None

    def check(self) -> None:
        """Raise InputError for a choice that does not exist."""
        _choose("--model", self.model, MODELS)
        _choose("--reduction", self.reduction, REDUCTIONS)
        _choose("--protection", self.protection, PROTECTION_MODES)
        _choose("--start", self.start, STARTS)
        for node, owner in self.nodes.items():
            _choose(f"--node {node}", owner, OWNERS)
        if not 0.0 <= self.state_of_charge <= 1.0:
            raise InputError("state of charge", "0 to 1", f"{self.state_of_charge:g}")


def _choose(where: str, value: str, known: tuple[str, ...]) -> None:
    if value not in known:
        raise InputError(
            where, f"one of {', '.join(known)}", f"'{value}'", did_you_mean(value, known)
        )


def vehicle_path(name: str) -> Path:
    """Return the file of a shipped vehicle, or of a path; raises InputError."""
    return shipped_or_path(name, folder("vehicles"), "--vehicle")


def load_car(name: str) -> tuple[DrivelineParameters, Machines, CarFile, str]:
    """Return a car's parameters, checked, with the file and its path; raises InputError."""
    # What a vehicle file may hold takes long to import; most runs find their car built.
    from hev_can_emu.ecu.transmission_file import CarFile
    from hev_can_emu.plant.vehicle_file import driveline_parameters, machine_parameters

    path = vehicle_path(name)
    file = config.load(path, CarFile)
    return (
        driveline_parameters(file.driveline, str(path)),
        machine_parameters(file, str(path)),
        file,
        str(path),
    )


def network_files(setup: Setup) -> tuple[Path, config.Document, Bindings]:
    """Return the DBC's path, and the bindings with the document that locates complaints."""
    dbc = Path(setup.dbc) if setup.dbc else folder("dbc") / "hev.dbc"
    beside = Path(setup.bindings) if setup.bindings else bindings_beside(dbc)
    document = config.read(beside or folder("dbc") / "hev.bindings.yaml")
    return dbc, document, document.convert(Bindings)


def bindings_beside(dbc: Path) -> Path | None:
    """Return ``NAME.bindings.yaml`` beside ``NAME.dbc`` where it exists."""
    if not dbc.stem or not dbc.is_file():
        return None  # told when it is read
    path = dbc.with_name(f"{dbc.stem}.bindings.yaml")
    return path if path.is_file() else None


class FaultFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A file of prepared faults as :func:`hev_can_emu.ecu.faults.parse` takes them, counted from 0."""

    version: Literal[1]
    faults: tuple[dict[str, Any], ...]


def prepared_faults(setup: Setup) -> tuple[tuple[Fault, ...], Callable[[int], str]]:
    """Return the prepared faults and what locates complaints about one; raises InputError."""
    if setup.faults is None and setup.dbc is not None:
        return (), str
    path = Path(setup.faults) if setup.faults else folder("dbc") / "hev.faults.yaml"
    document = config.read(path)

    def locate(number: int) -> str:
        return document.where(("faults", number))

    given = document.convert(FaultFile).faults
    return tuple(parse(each, locate(number)) for number, each in enumerate(given)), locate
