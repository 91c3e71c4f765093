"""The shape of a bindings file: frozen records that the YAML reader fills; unknown keys are refused.

Annotations are evaluated where they stand: msgspec takes three times as long to evaluate each as a text.
"""

from typing import Literal

import msgspec

from hev_can_emu.ecu.network_file import ProtectionBinding, Sending
from hev_can_emu.ecu.sensors_file import Sensor
from hev_can_emu.ecu.supervision_file import Supervision

Ownership = Literal["emulated", "external", "silent"]


class Tie(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One signal's port where more than the name is to be said.

    ``unit`` stands in for the DBC's; ``factor`` is a sign or scale between the signal, converted to SI,
    and the port (``port = factor * signal``); ``values`` gives the port's code for each label of the
    signal's value table, labels left out mean not available.
    """

    port: str
    unit: str | None = None
    factor: float = 1.0
    values: dict[str, int] = {}


class MessageBinding(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One message's signals by name: ``request`` of a controller, ``status`` and ``external`` of a unit.

    ``node`` stands in for the sender that the DBC names, ``protection`` and ``sending`` for what it says
    of both.  Signals in ``optional`` may be not available without the message being defective;
    ``constant`` signals are always sent with this value or label.
    """

    node: str = ""
    request: dict[str, str | Tie] = {}
    status: dict[str, str | Tie] = {}
    external: dict[str, str | Tie] = {}
    optional: tuple[str, ...] = ()
    constant: dict[str, float | str] = {}
    protection: ProtectionBinding | None = None
    sending: Sending | None = None
    supervision: Supervision | None = None


class NodeBinding(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One node: the controller under test, or a unit that this program can emulate.

    Without ``ownership`` a controller is external and a unit is emulated.
    """

    role: Literal["controller", "emulated"]
    ownership: Ownership | None = None


class Bindings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A bindings file; nodes count in the file's order; ``sensors`` by status port.

    Messages in ``leave_out`` are not read from the DBC, whatever is wrong with them.
    """

    version: Literal[1]
    nodes: dict[str, NodeBinding]
    messages: dict[str, MessageBinding]
    sensors: dict[str, Sensor] = {}
    leave_out: tuple[str, ...] = ()
