"""The shape of a sensor in a bindings file.

Annotations are evaluated where they stand: msgspec takes three times as long to evaluate each as a text.
"""

import msgspec


class Sensor(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What lies between a quantity and its measurement, as quantities with units (``0.5 rpm``, ``10 ms``).

    A step or zone of a temperature is one in K.
    """

    resolution: str = ""
    filter: str = ""
    dead_zone: str = ""
