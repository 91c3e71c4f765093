"""What identification is given: measurements with tolerances, and what is known of each parameter.

This is the schema of ``vehicles/targets/*.yaml``; :mod:`hev_can_emu.plant.problem` turns it into SI.
"""

from __future__ import annotations

from typing import Literal

import msgspec

Quantity = Literal["undamped", "damped", "damping_ratio"]


class Known(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A parameter: known (``value``), sought (``lower`` and ``upper``), or tied (``same_as``).

    A sought parameter's ``value``, where given, is the most plausible one; else the middle of its
    range on a logarithmic scale is.
    """

    value: float | None = None
    lower: float | None = None
    upper: float | None = None
    unit: str | None = None
    same_as: str | None = None
    source: str = ""
    note: str = ""


class Measured(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One measured number; ``tolerance`` in its unit (for a printed number: half its last digit)."""

    value: float
    unit: str
    tolerance: float


class Given(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A number without tolerance: what the experiment was set to."""

    value: float
    unit: str


class FrequencySet(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Measured modes of one model in one configuration, lowest first; null where not measured."""

    model: Literal["16dof", "4dof"]
    configuration: str
    unit: str
    tolerance: float
    undamped: list[float | None] = []
    damped: list[float | None] = []
    damping_ratio: list[float | None] = []
    damping_ratio_tolerance: float | None = None


class Sample(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The car's measured speed or acceleration at an instant (s, on a grid of 0.01 s)."""

    quantity: Literal["vehicle_speed", "vehicle_acceleration"]
    time: float
    value: float
    unit: str
    tolerance: float


class StepTargets(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A torque step from rest: samples of a car's response, and the numbers of Figure 12.

    The speeds are read at ``read_out_time``; the others compare the 16-DOF with the 4-DOF model, as in
    Dai et al. 2024.  ``samples`` are compared with the 16-DOF model.
    """

    configuration: str
    step_time: Given
    read_out_time: Given
    engine_torque: Given
    em2_torque: Given
    samples: list[Sample] = []
    velocity_16dof: Measured | None = None
    velocity_4dof: Measured | None = None
    velocity_difference: Measured | None = None
    acceleration_difference: Measured | None = None
    acceleration_difference_time: Measured | None = None


class TargetsFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A targets file."""

    version: int
    name: str
    provenance: str
    frequencies: list[FrequencySet]
    inertias: dict[str, Known]
    stiffness: dict[str, Known]
    damping: dict[str, Known]
    base_radii: dict[str, Known]
    tyre_radius: Known
    ratio_rounding: dict[str, Known] = {}
    step_response: StepTargets | None = None
