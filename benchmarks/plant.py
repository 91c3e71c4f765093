"""The plant beside its peers, in one run on one core: python benchmarks/plant.py

Peers on the same linear driveline (parallel G1, without any machine, friction or event): SciPy's `solve_ivp`
started anew each millisecond, as a co-simulation must (Radau and LSODA, rtol 1e-6), `scipy.signal.lsim` and
`dlsim`, and openTorsion's transient simulation over a whole run.  Ours is always the whole plant of
that name.  Rounds are interleaved and the best of each is told; time is the process's own on one core, so
that a busy machine adds little; figures are multiples of real time.  The last lines are the time that a
fresh process takes to its first tick.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable

import numpy as np
import opentorsion as ot
from scipy.integrate import solve_ivp
from scipy.signal import dlsim, lsim

from hev_can_emu.plant.state_space import discrete, state_space
from hev_can_emu.plant.structure import BRANCHES, CONFIGURATIONS, full_order
from hev_can_emu.plant.vehicle import MESHES, DrivelineParameters
from hev_can_emu.runtime.bench import Bench
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.setup import Setup, load_car

# A BLAS's workers go on turning for a while after each call, on the process's time and in its cache.
ONE_THREAD = {f"{library}_NUM_THREADS": "1" for library in ("OPENBLAS", "MKL", "OMP")}
ROUNDS = 7
FIRST_TICKS = 5
TORQUE = 60.0  # N m, of EM2
GOALS: dict[str, tuple[float | None, float | None]] = {
    "4dof": (None, None),
    "16dof": (300.0, 2000.0),
    "detailed": (None, 40.0),
}
NAN = float("nan")

Case = tuple[str, Callable[[], float], float | None]
"""Name, a run that returns the seconds it simulated, the goal in multiples of real time."""


def peers(parameters: DrivelineParameters) -> list[Case]:
    """Return what one would take instead, on the linear driveline in parallel G1."""
    system = state_space(
        full_order(parameters), CONFIGURATIONS["parallel_g1"], parameters.tyre_radius
    )
    force = system.b[:, system.input("em2_torque")] * TORQUE
    start = np.zeros(len(system.a))

    def restarted(method: str, milliseconds: int) -> float:
        x = start
        for _ in range(milliseconds):
            x = solve_ivp(
                lambda t, y: system.a @ y + force, (0.0, 1e-3), x, method=method, rtol=1e-6,
                atol=1e-9, jac=system.a if method == "Radau" else lambda t, y: system.a,
            ).y[:, -1]  # fmt: skip
        return milliseconds * 1e-3

    times = np.arange(1001) * 1e-3
    inputs = np.full((len(times), 1), TORQUE)
    column = force[:, None] / TORQUE
    nothing = np.zeros((1, 1))
    row = system.c[[system.output("vehicle_speed")]]

    def whole_lsim() -> float:
        lsim((system.a, column, row, nothing), inputs, times)
        return float(times[-1])

    ad, bd = discrete(system, 1e-3)
    step = bd[:, [system.input("em2_torque")]]

    def whole_dlsim() -> float:
        dlsim((ad, step, row, nothing, 1e-3), inputs)
        return float(times[-1])

    assembly = open_torsion(parameters)
    node = PARTS.index("Jm2")

    a, b, _, _ = assembly.state_space()
    own_ad, own_bd = assembly.continuous_2_discrete(a, b, 1e-3)
    torques = np.zeros((len(PARTS), len(times)))
    torques[node] = TORQUE

    def open_torsion_loop() -> float:
        # What its `dsim` does; its minimal coordinates grow without bound with elastic gears.
        x = np.zeros((len(own_ad), len(times)))
        for i in range(len(times) - 1):
            x[:, i + 1] = own_ad @ x[:, i] + own_bd @ torques[:, i]
        assert np.isfinite(x[:, -1]).all()
        return float(times[-1])

    return [
        ("SciPy Radau, restarted each ms", lambda: restarted("Radau", 5), None),
        ("SciPy LSODA, restarted each ms", lambda: restarted("LSODA", 20), None),
        ("SciPy lsim, whole run", whole_lsim, None),
        ("SciPy dlsim, whole run", whole_dlsim, None),
        ("openTorsion, whole run", open_torsion_loop, None),
    ]


MERGED = {"Jc2": "Jc1", "Jg11": "Jsleeve"}
PARTS: list[str] = []


def open_torsion(p: DrivelineParameters) -> ot.Assembly:
    """Return the same driveline in openTorsion, C1 and G1 closed."""
    PARTS[:] = [name for name in p.inertias if name not in MERGED]
    node = {name: PARTS.index(MERGED.get(name, name)) for name in p.inertias}
    shafts, gears = [], []
    for branch, start, end, r_start, r_end in BRANCHES:
        k, c = p.stiffness[f"k{branch}"], p.damping[f"c{branch}"]
        if branch not in MESHES:
            shafts.append(ot.Shaft(node[start], node[end], k=k, c=c))
            continue
        first, second = p.base_radii[r_start], p.base_radii[r_end]
        parent = ot.ElasticGear(node[start], I=0.0, R=first)
        child = ot.ElasticGear(
            node[end], I=0.0, R=second, k=k * first**2, c=c * first**2, parent=parent
        )
        gears += [parent, child]
    disks = [ot.Disk(node[name], I=value) for name, value in p.inertias.items()]
    return ot.Assembly(shafts, disk_elements=disks, elastic_gear_elements=gears)


def plants() -> list[Case]:
    """Return the whole plant of each fidelity in series drive, on the bench and on its bus."""
    cases: list[Case] = []
    for model, (one, many) in GOALS.items():
        car = Bench(Setup(model=model))
        car.command(
            em1_mode=2.0, em1_speed=160.0, em1_torque_min=NAN, em1_torque_max=NAN,
            em2_mode=1.0, em2_torque=TORQUE, em2_torque_min=NAN, em2_torque_max=NAN,
            clutch_capacity=150.0, brake_torque=500.0,
        )  # fmt: skip
        car.advance(2000)
        car.command(engine_run=1.0, engine_torque=40.0)
        car.advance(2000)
        assert car.truth("clutch_held") == 1.0
        assert car.truth("engine_speed") > 100.0

        def by_call(car: Bench = car) -> float:
            for _ in range(200):
                car.run(1)
            return 0.2

        def at_once(car: Bench = car) -> float:
            car.run(1000)
            return 1.0

        cases.append((f"{model}, one tick per call", by_call, one))
        cases.append((f"{model}, a thousand ticks per call", at_once, many))
    for model in ("16dof", "detailed"):
        emulator = Emulator(Setup(model=model))

        def on_bus(emulator: Emulator = emulator) -> float:
            emulator.advance(emulator.now_ns + 1_000_000_000)
            return 1.0

        cases.append((f"{model} with its control units and bus", on_bus, None))
    return cases


FIRST_TICK = """
from hev_can_emu.runtime.bench import Bench
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.setup import Setup
Emulator(Setup(model={model!r})).advance(1_000_000)
"""


def first_tick(model: str) -> float:
    """Return the seconds of a core from the start of a fresh process to the end of its first tick."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-c", FIRST_TICK.format(model=model)], check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


def main() -> None:
    """Print multiples of real time, and the time to the first tick."""
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    parameters, *_ = load_car("dai2024")
    cases = peers(parameters) + plants()
    best = {name: 0.0 for name, *_ in cases}
    for _ in range(ROUNDS + 1):  # the first round compiles and warms up
        for name, run, _ in cases:
            started = time.process_time()
            simulated = run()
            best[name] = max(best[name], simulated / (time.process_time() - started))
    for name, _, goal in cases:
        told = "" if goal is None else f"   goal {goal:g}"
        print(f"{name:<42} {best[name]:10.3g} x real time{told}")
    for model in ("16dof", "detailed"):
        times = [first_tick(model) for _ in range(FIRST_TICKS)]
        told = f"{min(times):10.2f} s   goal 2.5 s"
        print(f"{f'first tick of a fresh process, {model}':<42} {told}")


if __name__ == "__main__":
    if not ONE_THREAD.items() <= os.environ.items():
        os.execve(sys.executable, [sys.executable, *sys.argv], os.environ | ONE_THREAD)
    main()
