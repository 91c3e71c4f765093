"""Build hook: put the DBC, the vehicles and the scenarios inside the wheel.

Only into a wheel that is to be shipped: a plain ``force-include`` would also copy them into an
editable installation, where the copies go stale beside the files of the repository.
"""

from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

FOLDERS = ("dbc", "vehicles", "scenarios")


class DataFolders(BuildHookInterface[Any]):
    """Adds ``FOLDERS`` to the wheel as ``hev_can_emu/_data/...``."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Name the folders to include, unless the installation is editable."""
        if version != "editable":
            build_data["force_include"] |= {f: f"hev_can_emu/_data/{f}" for f in FOLDERS}
