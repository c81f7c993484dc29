"""Measures in a process of its own what is called from Python, and prints one number.

Arguments: what to measure, the folder of the FMUs, and a count. The loop is the one of
tests/matrix/importer.py with `Pid`, in parallel order, so that all masters make the same calls.
"""

import sys
import time
from collections.abc import Callable, Iterable
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

WHAT, FOLDER, COUNT = sys.argv[1], Path(sys.argv[2]), int(sys.argv[3])
STEP = 0.001


# --- one FMU: the time to set an input, step, and get an output [ns] ------------------------------


def call_instance(in_process: bool) -> float:
    """Call an `Instance` of `fmu_master`."""
    from fmu_master import Instance

    with Instance(FOLDER / "Pid.fmu", in_process=in_process) as pid:
        pid.step(STEP)
        begin = time.perf_counter_ns()
        for k in range(COUNT):
            pid.set("y", 0.001 * (k % 2))
            pid.step(STEP)
            pid.get("u")
        return (time.perf_counter_ns() - begin) / COUNT


def call_fmpy() -> float:
    """Call FMPy's own API."""
    import fmpy_script

    return fmpy_script.call(FOLDER, COUNT)


def in_a_run(run: Callable[[float], object]) -> float:
    """Return the time of a step of a run to some time [s]; loading the FMU does not count."""
    times = []
    for steps in (10, 10 + COUNT):
        begin = time.perf_counter_ns()
        run(steps * STEP)
        times.append(time.perf_counter_ns() - begin)
    return (times[1] - times[0]) / COUNT


def run_by_us(in_process: bool) -> float:
    """Run `fmu_master.simulate`."""
    from fmu_master import simulate

    options: dict[str, Any] = {"output": ["u"], "step_size": STEP, "in_process": in_process}

    def run(stop: float) -> object:
        rows = {"time": [0.0, stop], "y": [0.0, 0.001]}
        return simulate(FOLDER / "Pid.fmu", stop_time=stop, input=rows, **options)

    return in_a_run(run)


def run_by_fmpy() -> float:
    """Run `fmpy.simulate_fmu`."""
    import fmpy
    import numpy as np

    options: dict[str, Any] = {"output": ["u"], "output_interval": STEP, "fmi_type": "CoSimulation"}

    def run(stop: float) -> object:
        rows = np.array([(0.0, 0.0), (stop, 0.001)], [("time", float), ("y", float)])
        with redirect_stdout(sys.stderr):  # FMPy says which inputs are missing
            return fmpy.simulate_fmu(FOLDER / "Pid.fmu", stop_time=stop, input=rows, **options)

    return in_a_run(run)


# --- three FMUs: the time of a step of the loop [ns]; the angle is recorded or read ---------------


def importer() -> Any:
    """Return tests/matrix/importer.py, which reads the arguments of the program."""
    sys.argv[1:] = [WHAT, "co-simulation", "pid", str(FOLDER), "", str(COUNT), ""]
    import importer

    return importer


def links() -> list[tuple[str, str]]:
    """Return the connections of the loop."""
    return [(f"{a}.{output}", f"{b}.{i}") for a, output, b, i in importer().CONNECTIONS]


def system() -> Any:
    """Return the loop for `fmu_master`."""
    from fmu_master import System

    return System(components=importer().FMUS, connections=links(), step=STEP, stop=STEP)


def simulate(in_process: bool) -> float:
    """Run the loop with `fmu_master`."""
    options = {"output": ["plant.theta"], "order": "parallel", "in_process": in_process}
    with system().loaded() as loaded:
        for steps in (1, COUNT):  # the first run loads the FMUs
            begin = time.perf_counter_ns()
            loaded.simulate(stop_time=steps * STEP, **options)
        return (time.perf_counter_ns() - begin) / COUNT


def our_master_on_fmpy() -> float:
    """Run the loop with the FMPy master of `pendulum_fmus`."""
    from pendulum_fmus.master import Component, FmpySystem, simulate

    components = [Component(name, file) for name, file in importer().FMUS.items()]
    with FmpySystem(components, links()) as system:
        begin = time.perf_counter_ns()
        simulate(system, 0.0, STEP, COUNT, order="parallel", record=["plant.theta"])
        return (time.perf_counter_ns() - begin) / COUNT


def loop_on_fmpy() -> float:
    """Step the loop by FMPy's own API."""
    import fmpy_script

    return fmpy_script.loop(importer().FMUS, importer().CONNECTIONS, COUNT)


def instances(in_process: bool) -> float:
    """Step the loop with instances of `fmu_master`."""
    from fmu_master import Instance

    loop = importer()
    own = {name: Instance(file, in_process=in_process) for name, file in loop.FMUS.items()}
    return stepped(loop.in_parallel(own, lambda instance, _: instance.step(STEP)))


def stepped(angles: Iterable[float]) -> float:
    """Return the time of a step [ns], without the initialization."""
    rest = iter(angles)
    next(rest)
    begin = time.perf_counter_ns()
    count = sum(1 for _ in rest)
    return (time.perf_counter_ns() - begin) / count


# --- the rest -------------------------------------------------------------------------------------


def first_result() -> float:
    """Import `fmu_master` and run the plant; return the time [ns]."""
    begin = time.perf_counter_ns()
    from fmu_master import simulate

    simulate(FOLDER / "Pendulum.fmu", stop_time=1.0)
    return time.perf_counter_ns() - begin


def first_result_of_fmpy() -> float:
    """Do the same with FMPy."""
    begin = time.perf_counter_ns()
    import fmpy

    fmpy.simulate_fmu(FOLDER / "Pendulum.fmu", stop_time=1.0)
    return time.perf_counter_ns() - begin


def sweep() -> float:
    """Run the sweep of a file, in place of the folder, in COUNT processes; return the time [ns]."""
    from fmu_master import sweep

    begin = time.perf_counter_ns()
    sweep(FOLDER, processes=COUNT)
    return time.perf_counter_ns() - begin


SUBJECTS: dict[str, Callable[[], float]] = {
    "call/Instance, in process": lambda: call_instance(True),
    "call/Instance": lambda: call_instance(False),
    "call/FMPy": call_fmpy,
    "call/simulate, in process": lambda: run_by_us(True),
    "call/simulate": lambda: run_by_us(False),
    "call/simulate_fmu": run_by_fmpy,
    "master/simulate, in process": lambda: simulate(True),
    "master/simulate": lambda: simulate(False),
    "master/Instance, in process": lambda: instances(True),
    "master/Instance": lambda: instances(False),
    "master/FMPy": loop_on_fmpy,
    "master/ours on FMPy": our_master_on_fmpy,
    "first/ours": first_result,
    "first/FMPy": first_result_of_fmpy,
    "sweep": sweep,
}


def other() -> float:
    """Step the loop with another master, a function of tests/matrix/importer.py."""
    return stepped(getattr(importer(), WHAT.removeprefix("master/"))())


print(SUBJECTS.get(WHAT, other)())
