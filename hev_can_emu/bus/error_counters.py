"""A node's fault confinement: error counters, error passive, bus-off (ISO 11898-1:2015, 12.1.4)."""

from __future__ import annotations

PASSIVE_ABOVE = 127
BUS_OFF_ABOVE = 255
AFTER_PASSIVE = 127  # "a value between 119 and 127" once a passive receiver has heard a good frame
RECOVERY_SEQUENCES = (
    128  #: sequences of 11 recessive bits until a node that was off takes part again
)

ACTIVE, PASSIVE, BUS_OFF = "error active", "error passive", "bus off"


class ErrorCounters:
    """Transmit and receive error counter of one node.

    Attributes:
        transmit: transmit error counter; above 255 the node is off the bus.
        receive: receive error counter.
        state: ACTIVE, PASSIVE or BUS_OFF.
    """

    __slots__ = ("receive", "state", "transmit")

    def __init__(self) -> None:
        self.recover()

    def recover(self) -> None:
        """Start anew, as after bus-off."""
        self.transmit = 0
        self.receive = 0
        self.state = ACTIVE

    def turn_off(self) -> None:
        """Leave the bus, for whatever reason."""
        self.transmit = max(self.transmit, BUS_OFF_ABOVE + 1)
        self._settle()

    def sent(self) -> None:
        """Note a frame sent (rule g)."""
        self.transmit = max(self.transmit - 1, 0)
        self._settle()

    def received(self) -> None:
        """Note a frame received (rule h)."""
        if self.receive > PASSIVE_ABOVE:
            self.receive = AFTER_PASSIVE
        elif self.receive > 0:
            self.receive -= 1
        self._settle()

    def failed_to_send(self, *, unacknowledged: bool = False) -> None:
        """Note an error in a frame that this node sent (rule c).

        A passive sender that nobody acknowledges, and whose flag nobody answers, is not counted up
        (exception 1): alone on a bus it never goes off.
        """
        if not (unacknowledged and self.state == PASSIVE):
            self.transmit += 8
        self._settle()

    def failed_to_receive(self, *, first: bool = False) -> None:
        """Note an error in another's frame (rule a); the ``first`` to see it pays 8 more (rule b)."""
        self.receive += 9 if first else 1
        self._settle()

    def _settle(self) -> None:
        if self.transmit > BUS_OFF_ABOVE:
            self.state = BUS_OFF
        elif self.transmit > PASSIVE_ABOVE or self.receive > PASSIVE_ABOVE:
            self.state = PASSIVE
        else:
            self.state = ACTIVE
