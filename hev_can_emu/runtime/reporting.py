"""From a run to what a report shows of it: curves read from what was on the bus, spans from events."""

from __future__ import annotations

import importlib.metadata
import platform
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt

from hev_can_emu.errors import InputError
from hev_can_emu.messages.definitions import SignalDef
from hev_can_emu.plant.powertrain import TRUTH
from hev_can_emu.plant.truth_units import truth_unit
from hev_can_emu.report.figures import ribbon_of
from hev_can_emu.report.run_report import Curve, Happening, Panel, Period, RunReport, Span
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.fault_book import InjectedFault
from hev_can_emu.runtime.playing import Playing, RunResult
from hev_can_emu.runtime.signal_log import SignalLog
from hev_can_emu.runtime.statistics import Statistics
from hev_can_emu.runtime.status_signals import status_in, status_signal

# What the overview shows of the status ports, where the network carries them.
_RIBBONS = ("driving_mode", "gear", "clutch_state", "engine_state", "contactor_state")
_PANELS = (
    ("vehicle", "km/h", ("vehicle_speed",)),
    ("speeds", "rpm", ("engine_speed", "em1_speed", "em2_speed")),
    ("torques", "Nm", ("engine_torque", "em1_torque", "em2_torque", "clutch_torque")),
)
_PACKAGES = ("hev-can-emu", "numpy", "numba", "cantools", "python-can")
_TRUTH = "truth."


class RunLog:
    """Keeps what a report needs of a run: its frames, and the truth where an expectation looks at it.

    To be closed when the run is over.
    """

    def __init__(self, playing: Playing) -> None:
        self._emulator = playing.emulator
        self.signals = SignalLog(playing.emulator.database, playing.emulator.constants.codec)
        self._truth_ns: list[npt.NDArray[np.int64]] = []
        self._truth: list[npt.NDArray[np.float64]] = []
        wanted = [name for each in playing.player.verdicts() for name in each.reads]
        self._end_watch: Callable[[], None] | None = None
        if any(name.startswith(_TRUTH) for name in wanted):
            self._end_watch = self._emulator.watch_truth(self._see)

    def close(self) -> None:
        """Look at the car no more."""
        if self._end_watch is not None:
            self._end_watch()

    def add(self, frames: npt.NDArray[np.void], count: int) -> None:
        """Keep frames."""
        self.signals.add(frames, count)

    def _see(self, t_ns: npt.NDArray[np.int64], truth: npt.NDArray[np.float64]) -> None:
        self._truth_ns.append(t_ns)
        self._truth.append(truth)

    def curve(self, name: str) -> Curve | None:
        """Return a signal or a quantity of the plant over the run; None where there is none such."""
        if name.startswith(_TRUTH):
            quantity = name.removeprefix(_TRUTH)
            if quantity not in TRUTH or not self._truth:
                return None
            values = np.concatenate(self._truth)[:, TRUTH.index(quantity)]
            times = np.concatenate(self._truth_ns).astype(np.float64) * 1e-9
            return Curve(name, truth_unit(quantity), times, values, {})
        try:
            signal = self._emulator.database.signal(name)
        except InputError:
            return None
        t_s, values = self.signals.series(signal.qualified_name)
        return Curve(signal.qualified_name, signal.unit, t_s, values, _labels(signal))


def make_report(
    playing: Playing,
    result: RunResult,
    log: RunLog,
    *,
    wall_s: float,
    clock: str,
    command: str,
    started: str = "",
    statistics: Statistics | None = None,
    files: Sequence[str] = (),
    ledger: Mapping[str, Any] | None = None,
) -> RunReport:
    """Return what is to be shown of a run.

    Args:
        playing, result: the run and what it came to.
        log: kept while it ran.
        wall_s: how long it took.
        clock: which one, and the bus where there is one.
        command: repeats it.
        started: date and time; empty in virtual time, which has none.
        statistics: of real time.
        files: names of the recordings beside the report.
        ledger: where the energy went, see :class:`RunReport`.
    """
    emulator = playing.emulator
    setup = emulator.setup
    car_s = result.car_ns * 1e-9
    curves: dict[str, Curve] = {}
    for verdict in result.verdicts:
        for name in verdict.reads:
            if verdict.kind != "step" and name not in curves and (found := log.curve(name)):
                curves[name] = found
    owners = ", ".join(f"{node} {owner}" for node, owner in sorted(setup.nodes.items()))
    return RunReport(
        name=result.name,
        file=result.file,
        description=playing.scenario.description,
        parameters=result.parameters,
        car={
            "vehicle": emulator.vehicle_name,
            "model": result.model,
            "start": result.start,
            "protection": setup.protection,
            "network": emulator.database.path.name,
            "nodes": owners or "as bound",
        },
        seed=result.seed,
        verdicts=result.verdicts,
        outcome=result.outcome,
        car_s=car_s,
        wall_s=wall_s,
        started=started,
        clock=clock,
        trace=result.trace_hash,
        happenings=[Happening(each.t_ns * 1e-9, each.kind, each.text) for each in result.events],
        spans=_spans(emulator, result, car_s),
        faults=_fault_lines(result.faults),
        timing=_timing(log, car_s, wall_s, statistics),
        periods=_periods(emulator, log),
        curves=curves,
        ribbons=[
            ribbon_of(curve, car_s)
            for port in _RIBBONS
            if (signal := status_signal(emulator, port)) is not None
            and (curve := log.curve(signal.qualified_name)) is not None
            and len(curve.t_s)
        ],
        panels=_panels(emulator, log),
        versions=_versions(),
        command=command,
        files=files,
        ledger=ledger,
    )


def _labels(signal: SignalDef) -> dict[float, str]:
    return {
        float(raw * signal.scale + signal.offset): label
        for raw, label in signal.labels.items()
        if raw != signal.not_available
    }


def _panels(emulator: Emulator, log: RunLog) -> list[Panel]:
    panels = []
    for title, unit_name, ports in _PANELS:
        found = []
        for port in ports:
            signal = status_signal(emulator, port)
            curve = None if signal is None else log.curve(signal.qualified_name)
            if curve is not None and len(curve.t_s):
                values = status_in(emulator, port, curve.values, unit_name)
                found.append(curve._replace(unit=unit_name, values=values))
        if found:
            panels.append(Panel(title, unit_name, found))
    return panels


def _spans(emulator: Emulator, result: RunResult, end_s: float) -> list[Span]:
    """Return faults, and the times for which requests were lost."""
    spans = []
    for fault in result.faults:
        start_s = fault.start_ns * 1e-9
        stop_s = end_s if fault.until_ns is None else min(fault.until_ns * 1e-9, end_s)
        if start_s < end_s:
            spans.append(Span("fault", fault.name, start_s, max(stop_s, start_s)))
    since: dict[int, float] = {}
    messages = emulator.database.messages
    for event in result.events:
        if event.kind == "lost":
            since.setdefault(event.number, event.t_ns * 1e-9)
        elif event.kind == "healed" and event.number in since:
            name = messages[event.number].name
            spans.append(Span("lost", name, since.pop(event.number), event.t_ns * 1e-9))
    spans += [Span("lost", messages[index].name, start, end_s) for index, start in since.items()]
    return sorted(spans, key=lambda span: (span.kind, span.start_s))


def _fault_lines(faults: Sequence[InjectedFault]) -> list[str]:
    lines = []
    for fault in faults:
        fields = msgspec.to_builtins(fault.fault)
        kind = fields.pop("fault")
        told = ", ".join(
            f"{key} {value}" for key, value in fields.items() if key != "name" and value is not None
        )
        until = "the end" if fault.until_ns is None else f"{fault.until_ns * 1e-9:.3f} s"
        lines.append(
            f"{fault.name}: {kind} ({told}), {fault.start_ns * 1e-9:.3f} s to {until}, "
            f"acted {fault.hits} times"
        )
    return lines


def _periods(emulator: Emulator, log: RunLog) -> list[Period]:
    periods = []
    for message in emulator.database.messages:
        t_ns = log.signals.instants_ns(message)
        if len(t_ns) < 2:
            continue
        gaps = np.diff(t_ns) * 1e-6
        periods.append(
            Period(
                message.name,
                message.sender,
                len(t_ns),
                message.cycle_time_ns * 1e-6,
                float(gaps.mean()),
                float(gaps.min()),
                float(gaps.max()),
            )
        )
    return periods


def _timing(
    log: RunLog, car_s: float, wall_s: float, statistics: Statistics | None
) -> Mapping[str, str]:
    frames = log.signals.count
    told = {
        "Frames": f"{frames}, {frames / car_s:.0f} a second" if car_s > 0 else f"{frames}",
        "Duration": f"{car_s:.3f} s of the car's time in {wall_s:.2f} s",
    }
    if statistics is None:
        if wall_s > 0:
            told["Speed"] = f"{car_s / wall_s:.1f} times real time"
        return told
    late = statistics.lateness
    told["Ticks"] = f"{statistics.ticks}, {statistics.overruns} of them overruns"
    told["Tick done after its deadline"] = (
        f"{late.quantile_us(0.5):.0f} us (median), {late.quantile_us(0.99):.0f} us (99 %), "
        f"{late.largest_us:.0f} us (most)"
    )
    if statistics.stalls:
        told["Stalls"] = f"{statistics.stalls}, {statistics.stalled_ns * 1e-9:.1f} s in all"
    told["On the bus"] = f"{statistics.sent} frames sent, {statistics.received} received"
    return told


def _versions() -> dict[str, str]:
    told = {"hev-can-emu": ""} | {name: importlib.metadata.version(name) for name in _PACKAGES}
    told["Python"] = platform.python_version()
    told["system"] = f"{platform.system()} {platform.machine()}"
    return told
