"""A driveline as the text of a vehicle file."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Mapping

from hev_can_emu.plant.problem import UNITS
from hev_can_emu.plant.vehicle import SECTIONS, DrivelineParameters

DIGITS = 12
"""Significant digits written: frequencies printed with seven need more than seven."""


def vehicle_text(
    parameters: DrivelineParameters,
    name: str,
    provenance: str,
    sources: Mapping[str, str],
) -> str:
    """Return a vehicle file (YAML) in SI.

    Args:
        parameters: the driveline.
        name: the vehicle's name.
        provenance: in plain words, where the numbers come from.
        sources: source of each value by ``section.name`` (``tyre_radius`` alone).
    """
    folded = textwrap.fill(provenance, 110, initial_indent="  ", subsequent_indent="  ")
    lines = ["version: 1", f"name: {json.dumps(name)}", "provenance: >-", folded, "", "driveline:"]

    def value(key: str, number: float, unit: str) -> str:
        source = json.dumps(sources.get(key, "identified"))
        return f"{{value: {number:.{DIGITS}g}, unit: {json.dumps(unit)}, source: {source}}}"

    for section, names in SECTIONS.items():
        lines.append(f"  {section}:")
        given: dict[str, float] = getattr(parameters, section)
        for one in names:
            key = f"{section}.{one}"
            if section == "reduced_ratios":
                text = value(f"ratio_rounding.{one}", given[one], "1")
            else:
                text = value(key, given[one], UNITS[key])
            lines.append(f"    {one}: {text}")
    lines.append(f"  tyre_radius: {value('tyre_radius', parameters.tyre_radius, 'm')}")
    return "\n".join(lines) + "\n"
