"""Rate limit, on change, refresh; the outbox keeps the newest and counts what it gives up."""

import json
import math

import numpy as np
import pytest

from hev_can_emu.telemetry.mqtt_feed import Feed
from hev_can_emu.telemetry.mqtt_outbox import Letter, Outbox
from hev_can_emu.telemetry.vss import Leaf

SPEED = Leaf("Vehicle.Speed", "speed", "km/h", gain=3.6)
GEAR = Leaf("Vehicle.Powertrain.Transmission.CurrentGear", "gear", datatype="int32")
EPOCH_NS = 1_800_000_000_000_000_000


def feed(period_s: float = 1.0, refresh_s: float = 10.0) -> Feed:
    return Feed([SPEED, GEAR], ["gear", "speed"], period_s, refresh_s)


def told(feed: Feed, speed: float, gear: float, now_s: float, t_ns: int = 0) -> dict[str, object]:
    due = feed.due(np.array([gear, speed]), 0, 0, now_s)
    return {topic: json.loads(payload)["value"] for topic, payload in due}


def test_the_first_snapshot_tells_all_with_value_unit_and_both_times() -> None:
    (topic, payload), _ = feed().due(
        np.array([1.0, 10.0]), 1_250_000_000, EPOCH_NS + 1_250_000_000, 0.0
    )
    assert topic == "Vehicle/Speed"
    assert json.loads(payload) == {
        "value": 36.0,
        "unit": "km/h",
        "time": 1.25,
        "timestamp": "2027-01-15T08:00:01.250Z",
    }


def test_only_changes_are_told_and_no_faster_than_the_rate() -> None:
    it = feed()
    told(it, 10.0, 1.0, 0.0)
    assert told(it, 11.0, 1.0, 0.5) == {}
    assert told(it, 12.0, 1.0, 1.0) == {"Vehicle/Speed": 43.2}
    assert told(it, 12.0, 2.0, 1.5) == {"Vehicle/Powertrain/Transmission/CurrentGear": 2}
    assert told(it, 12.0, 2.0, 5.0) == {}


def test_a_change_within_the_rate_is_told_when_its_time_has_come() -> None:
    it = feed()
    told(it, 10.0, 1.0, 0.0)
    assert told(it, 11.0, 1.0, 0.9) == {}
    assert told(it, 11.0, 1.0, 1.0) == {"Vehicle/Speed": 39.6}


def test_changes_below_the_last_digit_are_none() -> None:
    it = feed()
    told(it, 10.0, 1.0, 0.0)
    assert told(it, 10.0005, 1.0, 2.0) == {}


def test_all_is_told_again_after_the_refresh_time_and_when_asked_to_forget() -> None:
    it = feed()
    told(it, 10.0, 1.0, 0.0)
    assert len(told(it, 10.0, 1.0, 10.0)) == 2
    assert told(it, 10.0, 1.0, 10.5) == {}
    it.forget()
    assert len(told(it, 10.0, 1.0, 10.6)) == 2


def test_what_is_not_available_is_null_and_told_once() -> None:
    it = feed()
    assert told(it, math.nan, 1.0, 0.0)["Vehicle/Speed"] is None
    assert told(it, math.nan, 1.0, 2.0) == {}


def test_leaves_without_a_source_are_left_out() -> None:
    it = Feed([SPEED, GEAR], ["gear"], 0.0, 10.0)
    assert [topic for topic, _ in it.due(np.array([1.0]), 0, 0, 0.0)] == [GEAR.topic]


def letter(topic: str, text: str = "x") -> Letter:
    return Letter(topic, text.encode())


def test_the_newest_of_a_topic_takes_the_place_of_the_older() -> None:
    box = Outbox()
    for text in ("1", "2", "3"):
        box.put_value(letter("a", text))
    box.put_value(letter("b"))
    assert len(box) == 2
    assert box.replaced == 2
    assert box.take() == letter("a", "3")
    assert box.take() == letter("b")
    assert box.take() is None


def test_happenings_keep_their_order_go_first_and_are_bounded() -> None:
    box = Outbox(most=3)
    box.put_value(letter("value"))
    for number in range(5):
        box.put_happening(letter("event", str(number)))
    assert box.dropped == 2
    taken = [box.take() for _ in range(4)]
    assert [each.payload for each in taken if each] == [b"2", b"3", b"4", b"x"]


@pytest.mark.parametrize(("newer", "kept"), [(False, b"old"), (True, b"new")])
def test_what_could_not_be_sent_goes_back_unless_there_is_newer(newer: bool, kept: bytes) -> None:
    box = Outbox()
    if newer:
        box.put_value(letter("a", "new"))
    box.give_back(letter("a", "old"), happening=False)
    taken = box.take()
    assert taken is not None
    assert taken.payload == kept
    assert box.take() is None


def test_a_happening_goes_back_to_the_front() -> None:
    box = Outbox()
    box.put_happening(letter("e", "2"))
    box.give_back(letter("e", "1"), happening=True)
    assert box.take() == letter("e", "1")
