"""Scenarios started by MQTT on a running car, and told of by ``scenario run --mqtt``."""

import signal
from pathlib import Path

import pytest
from broker_rig import LIMIT_S, listener, mosquitto
from test_run import VIN, car

from hev_can_emu.cli import main

SHORT = """\
version: 1
name: pull away
duration: 1 s
parameters: {torque: 50 Nm}
steps:
  - at: 0 s
    set: {ContactorRequest: Closed, EM2ControlMode: Torque, EM2TorqueRequest: torque}
expectations:
  - {name: it moves, becomes: VehicleSpeed > 0.3 km/h, within: 1 s}
  - {name: not fast, always: VehicleSpeed < 100 km/h, from: 100 ms}
"""
FAILING = SHORT.replace("VehicleSpeed < 100 km/h", "VehicleSpeed < 0.1 km/h").replace(
    "pull away", "stay"
)


@pytest.fixture
def scenarios(tmp_path: Path) -> Path:
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "pull_away.yaml").write_text(SHORT)
    (folder / "endless.yaml").write_text(SHORT.replace("duration: 1 s", "duration: 1000 s"))
    return folder


def test_commands_start_and_stop_scenarios(tmp_path: Path, scenarios: Path) -> None:
    with mosquitto(tmp_path) as broker, listener(broker.port) as ear:
        address = f"mqtt://127.0.0.1:{broker.port}"
        options = ("--mqtt-commands", "--mqtt-scenarios", str(scenarios), "--mqtt-rate", "20")
        with car(tmp_path, address, *options) as process:
            ear.until("/status", lambda body: body["state"] == "online")

            def ask(verb: str, **body: object) -> dict[str, object]:
                ear.heard.clear()
                ear.ask(VIN, verb, body)
                answer: dict[str, object] = ear.until(f"/response/{verb}").body
                return answer

            assert ask("parameter", name="torque", value="80 Nm")["parameters"] == {
                "torque": "80 Nm"
            }
            answer = ask("scenario/start", scenario="pull_away")
            assert answer["ok"] is True, answer
            assert answer["scenario"] == "pull away"
            ear.until("/scenario/state", lambda b: b["state"] == "running")
            ear.until("/ElectricMotor/EM2/Torque", lambda b: b["value"] == 80)
            ended = ear.until("/scenario/state", lambda b: b["state"] == "ended").body
            assert ended["outcome"] == "pass"
            verdicts = [h.body for h in ear.heard if h.topic.endswith("/scenario/verdict")]
            assert {v["name"]: v["outcome"] for v in verdicts}["it moves"] == "pass"
            assert len({(v["kind"], v["name"]) for v in verdicts}) == len(verdicts)
            # The car of the run goes on as it was: at rest.
            ear.until("/Vehicle/IsMoving", lambda b: b["value"] is False)

            assert ask("scenario/start", scenario="endless", parameters={"torque": "60 Nm"})["ok"]
            busy = ask("scenario/start", scenario="pull_away")
            assert busy["error"] == ("command/scenario/start: a scenario is running; stop it first")
            ear.until("/ElectricMotor/EM2/Torque", lambda b: b["value"] == 60)
            # Verdicts are told as they are decided: this scenario has a long way to go.
            moves = ear.until("/scenario/verdict", lambda b: b["name"] == "it moves").body
            assert moves["outcome"] == "pass"
            assert not [
                h
                for h in ear.heard
                if h.topic.endswith("/scenario/state") and h.body["state"] == "ended"
            ]
            stopped = ask("scenario/stop")
            assert (stopped["ok"], stopped["outcome"]) == (True, "inconclusive")
            assert "no scenario is running" in str(ask("scenario/stop")["error"])
            unknown = ask("scenario/start", scenario="pull_awy")
            assert "did you mean 'pull_away'?" in str(unknown["error"])
            wrong = ask("scenario/start", scenario="pull_away", parameters={"torqe": 1})
            assert "expected a parameter of" in str(wrong["error"])
            process.send_signal(signal.SIGTERM)
            assert process.wait(LIMIT_S) == 0


@pytest.mark.parametrize(("text", "code", "outcome"), [(SHORT, 0, "pass"), (FAILING, 1, "fail")])
def test_a_scenario_in_virtual_time_is_told_with_its_verdicts(
    text: str, code: int, outcome: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "it.yaml"
    file.write_text(text)
    with mosquitto(tmp_path) as broker, listener(broker.port) as ear:
        address = f"mqtt://127.0.0.1:{broker.port}"
        assert main(["scenario", "run", str(file), "--mqtt", address, "--vin", VIN]) == code
        ended = ear.until("/scenario/state", lambda body: body["state"] == "ended").body
        assert ended["outcome"] == outcome
        assert len(ended["trace_hash"]) == 64
        verdict = ear.until("/scenario/verdict", lambda body: body["name"] == "not fast").body
        assert verdict["outcome"] == outcome
        ear.until("/status", lambda body: body["state"] == "offline")
    assert ended["trace_hash"] in capsys.readouterr().out


def test_commands_need_the_wall_clock(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "it.yaml"
    file.write_text(SHORT)
    options = ["--mqtt", "mqtt://127.0.0.1", "--mqtt-commands"]
    assert main(["scenario", "run", str(file), *options]) == 2
    assert capsys.readouterr().err == (
        "hev-can-emu: --mqtt-commands: expected --clock wall, got virtual time\n"
    )
