"""``run --mqtt`` as a process of its own beside a real broker."""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from broker_rig import LIMIT_S, free_port, listener, mosquitto

COMMAND = str(Path(sys.executable).parent / "hev-can-emu")
START_S = 400.0  # should the kernels have to be compiled first
VIN = "WVWZZZ1JZXW000001"


@contextmanager
def car(folder: Path, broker: str, *options: str) -> Iterator[subprocess.Popen[str]]:
    """A car on a free port that tells of itself; interrupted in the end."""
    with (folder / "out").open("w") as out, (folder / "err").open("w") as err:
        process = subprocess.Popen(
            [COMMAND, "run", "--bus", "socketcand:127.0.0.1:0", "--mqtt", broker, "--vin", VIN, *options],
            stdout=out, stderr=err, cwd=folder, text=True,
        )  # fmt: skip
    deadline = time.monotonic() + START_S
    while "join from another terminal" not in (folder / "out").read_text():
        assert process.poll() is None, (folder / "err").read_text()
        assert time.monotonic() < deadline
        time.sleep(0.02)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.wait()
    assert "Traceback" not in (folder / "err").read_text()


def test_a_car_is_told_of_obeys_and_says_that_it_leaves(tmp_path: Path) -> None:
    with mosquitto(tmp_path) as broker, listener(broker.port) as ear:
        address = f"mqtt://127.0.0.1:{broker.port}"
        options = ("--mqtt-commands", "--node", "HCU=emulated", "--mqtt-rate", "20")
        with car(tmp_path, address, *options) as process:
            status = ear.until(f"hev/{VIN}/status", lambda body: body["state"] == "online").body
            assert status["model"] == "16dof"
            assert status["commands"] is True
            assert re.fullmatch(r"\d+\.\d+\.\d+.*", status["version"])
            ear.until(
                "/Vehicle/Powertrain/HEV/DrivingMode", lambda b: b["value"] == "ELECTRIC_NEUTRAL"
            )
            for name, value in (
                ("HCU_HVRequest.ContactorRequest", "Closed"),
                ("EM2ControlMode", "Torque"),
                ("EM2TorqueRequest", "80 Nm"),
                ("AcceleratorPedal", "35 %"),
            ):
                ear.ask(VIN, "input", {"signal": name, "value": value, "id": name})
                answer = ear.until("/response/input", lambda b, n=name: b.get("id") == n).body
                assert answer["ok"] is True, answer
            speed = ear.until("/Vehicle/Speed", lambda body: body["value"] > 3.0).body
            assert speed["unit"] == "km/h"
            pedal = ear.until("/Chassis/Accelerator/PedalPosition", lambda b: b["value"] == 35)
            assert pedal.body["unit"] == "percent"
            torque = ear.until("/ElectricMotor/EM2/Torque", lambda b: b["value"] == 80).body
            assert torque["time"] <= speed["time"] + 10.0
            ear.ask(VIN, "input", {"signal": "EM2TorqueRequest", "value": "80 km/h"})
            refused = ear.until("/response/input", lambda b: not b["ok"]).body["error"]
            assert refused == (
                "command/input: value: expected a number in Nm or a label, got '80 km/h'; "
                "HCU_EM2Request.EM2TorqueRequest is in Nm"
            )
            ear.ask(VIN, "fault/inject", {"inject": {"fault": "drop", "message": "EMS_Status"}})
            name = ear.until("/response/fault/inject").body["name"]
            begun = ear.until("/event/fault", lambda b: "begins" in b["text"]).body
            assert begun["text"] == f"{name} begins"
            ear.until("/HEV/FaultsActive", lambda body: body["value"] == 1)
            ear.ask(VIN, "fault/inject", {"inject": {"fault": "drp", "message": "EMS_Status"}})
            refused = ear.until("/response/fault/inject", lambda b: not b["ok"]).body["error"]
            assert refused.startswith(
                "command/fault/inject: inject.fault: expected a kind of fault, got 'drp'; did you mean 'drop'"
            )
            ear.ask(VIN, "fault/clear", {})
            assert ear.until("/response/fault/clear").body["cleared"] == [name]
            ear.until("/event/fault", lambda b: b["text"].startswith(f"{name} ends, "))
            ear.heard.clear()
            process.send_signal(signal.SIGTERM)
            assert process.wait(LIMIT_S) == 0
            ear.until(f"hev/{VIN}/status", lambda body: body["state"] == "offline")
        assert re.search(r"MQTT: \d+ sent, .* 1 connections", (tmp_path / "out").read_text())


def test_a_killed_car_is_told_offline_by_its_last_will(tmp_path: Path) -> None:
    with (
        mosquitto(tmp_path) as broker,
        listener(broker.port) as ear,
        car(tmp_path, f"mqtt://127.0.0.1:{broker.port}") as process,
    ):
        ear.until("/status", lambda body: body["state"] == "online")
        ear.heard.clear()
        os.kill(process.pid, signal.SIGKILL)
        ear.until("/status", lambda body: body["state"] == "offline")


def test_without_a_broker_the_car_runs_and_says_so_once(tmp_path: Path) -> None:
    port = free_port()
    with car(tmp_path, f"mqtt://127.0.0.1:{port}", "--duration", "2") as process:
        assert process.wait(LIMIT_S) == 0
    told = (tmp_path / "err").read_text()
    assert told.count(f"no connection to mqtt://127.0.0.1:{port}") == 1
    assert "0 connections" in (tmp_path / "out").read_text()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--mqtt", "here"), "--mqtt: expected mqtt://HOST[:PORT], mqtts://HOST[:PORT] or"),
        (("--vin", VIN), "--vin: expected --mqtt beside it, got none"),
        (("--mqtt-commands",), "--mqtt-commands: expected --mqtt beside it, got none"),
        (("--mqtt", "mqtt://a", "--mqtt-rate", "fast"), "--mqtt-rate: expected a number from 0.01"),
        (("--mqtt", "mqtt://a", "--vin", "x"), "--vin: expected 17 capital letters and digits"),
    ],
)
def test_bad_options_are_told_in_one_line(
    options: tuple[str, ...], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    from hev_can_emu.cli import main

    assert main(["run", *options]) == 2
    told = capsys.readouterr().err
    assert told.startswith(f"hev-can-emu: {message}")
    assert told.count("\n") == 1
