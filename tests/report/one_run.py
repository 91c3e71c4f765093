"""A run's report made by hand, with names that would break what does not escape them."""

from __future__ import annotations

import numpy as np

from hev_can_emu.report.ribbons import Ribbon, Segment
from hev_can_emu.report.run_report import Curve, Happening, Panel, Period, RunReport, Span
from hev_can_emu.scenario.verdict import Outcome, Verdict

NASTY = "</script><script>window.hacked = 1</script><img src=x onerror='window.hacked = 1'> & \"q\""
S = 1_000_000_000


def verdict(kind: str, name: str, outcome: Outcome, expected: str, **more: object) -> Verdict:
    given: dict[str, object] = {
        "instant_ns": S, "observed": "EM2Torque = 45 Nm", "margin": -5.0, "margin_unit": "Nm",
        "where": "a.yaml:7: $.expectations[0]", "window_ns": (S // 2, 2 * S), "reads": ("M.EM2Torque",),
    }  # fmt: skip
    return Verdict(kind=kind, name=name, outcome=outcome, expected=expected, **(given | more))  # type: ignore[arg-type]


def one_run(name: str = NASTY, outcome: Outcome = Outcome.FAIL, **parameters: str) -> RunReport:
    t = np.arange(0.0, 3.0, 0.01)
    torque = Curve("M.EM2Torque", "Nm", t, 100.0 * np.sin(2.0 * t), {})
    gear = Curve("M.Gear", "", t, np.where(t < 1.0, 0.0, 1.0), {0.0: "Neutral", 1.0: NASTY})
    return RunReport(
        name=name,
        file="a.yaml",
        description=NASTY,
        parameters={"mass": "1500 kg", **parameters},
        car={"vehicle": "dai2024", "model": "4dof", "start": "ready"},
        seed=7,
        verdicts=(
            verdict("step", "pull", Outcome.PASS, "at 1 s", observed="", margin=None, reads=()),
            verdict("step", "wait", Outcome.FAIL, "x within 1 s", instant_ns=None, margin=None),
            verdict("expectation", NASTY, outcome, f"always: EM2Torque > 50 Nm {NASTY}"),
            verdict("expectation", "unsure", Outcome.INCONCLUSIVE, "never: EM2Torque > 90 Nm"),
            verdict("expectation", "good", Outcome.PASS, "settles: EM2Torque = 40 ± 9 Nm"),
            verdict("expectation", "gear", Outcome.PASS, "always: Gear == 1", reads=("M.Gear",)),
            verdict("expectation", "broken", Outcome.ERROR, "\x00control\x1b characters"),
        ),
        outcome=Outcome.ERROR,
        car_s=3.0,
        wall_s=0.25,
        started="",
        clock="virtual",
        trace="ab" * 32,
        happenings=(Happening(0.5, "lost", NASTY), Happening(0.7, "lock", "C1 holds")),
        spans=(Span("fault", NASTY, 0.4, 0.9), Span("lost", "HCU_EM2Request", 0.5, 3.0)),
        faults=(NASTY,),
        timing={"Frames": "300"},
        periods=(Period("M", "N", 300, 10.0, 10.0, 9.0, 11.0),),
        curves={"M.EM2Torque": torque, "M.Gear": gear},
        ribbons=(Ribbon("DrivingMode", [Segment(0.0, 2.0, "Series"), Segment(2.0, 3.0, NASTY)]),),
        panels=(Panel("torques", "Nm", [torque]),),
        versions={"hev-can-emu": "0.1.0"},
        command="hev-can-emu scenario run a.yaml",
        files=("a run.log",),
    )
