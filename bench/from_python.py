"""Measures in a process of its own what is called from Python, and prints one number.

Arguments: what to measure, the folder of the FMUs, and a count. The loop is the one of
tests/matrix/importer.py with `Pid`, in parallel order, so that all masters make the same calls.
"""

import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

WHAT, FOLDER, COUNT = sys.argv[1], Path(sys.argv[2]), int(sys.argv[3])
STEP = 0.001


def loop() -> tuple[dict[str, Path], list[tuple[str, str]]]:
    """Return the FMUs and the connections."""
    sys.argv[1:] = [WHAT, "co-simulation", "pid", str(FOLDER), "", str(COUNT), ""]
    import importer

    links = [(f"{a}.{output}", f"{b}.{i}") for a, output, b, i in importer.CONNECTIONS]
    return importer.FMUS, links


def system() -> Any:
    """Return the loop for `fmu_master`."""
    from fmu_master import System

    fmus, links = loop()
    return System(components=fmus, connections=links, step=STEP, stop=STEP)


# --- the time of a step [ns]: the angle is recorded or read ---------------------------------------


def simulate(in_process: bool) -> float:
    """Run the loop with `fmu_master`."""
    options = {"output": ["plant.theta"], "order": "parallel", "in_process": in_process}
    with system().loaded() as loaded:
        for steps in (1, COUNT):  # the first run loads the FMUs
            begin = time.perf_counter_ns()
            loaded.simulate(stop_time=steps * STEP, **options)
        return (time.perf_counter_ns() - begin) / COUNT


def fmpy() -> float:
    """Run the loop with the FMPy master of `pendulum_fmus`."""
    from pendulum_fmus.master import Component, FmpySystem, simulate

    fmus, links = loop()
    with FmpySystem([Component(name, file) for name, file in fmus.items()], links) as system:
        begin = time.perf_counter_ns()
        simulate(system, 0.0, STEP, COUNT, order="parallel", record=["plant.theta"])
        return (time.perf_counter_ns() - begin) / COUNT


def by_hand(in_process: bool) -> Iterable[float]:
    """Step the loop with instances of `fmu_master`."""
    from fmu_master import Instance

    loop()
    import importer

    own = {name: Instance(file, in_process=in_process) for name, file in importer.FMUS.items()}
    return importer.in_parallel(own, lambda instance, _: instance.step(STEP))


def stepped(angles: Iterable[float]) -> float:
    """Return the time of a step [ns], without the initialization."""
    rest = iter(angles)
    next(rest)
    begin = time.perf_counter_ns()
    count = sum(1 for _ in rest)
    return (time.perf_counter_ns() - begin) / count


def other() -> float:
    """Step the loop with another master."""
    loop()
    import importer

    return stepped(getattr(importer, WHAT)())


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


def memory(in_process: bool) -> float:
    """Run COUNT short loops; return the resident memory of all processes [bytes]."""
    import psutil

    with system().loaded() as loaded:
        for k in range(COUNT):
            loaded.simulate({"controller.pid.kp": 100.0 + k % 100}, in_process=in_process)
        this = psutil.Process()
        return sum(process.memory_info().rss for process in [this, *this.children()])


SUBJECTS = {
    "simulate, in process": lambda: simulate(True),
    "simulate": lambda: simulate(False),
    "by hand, in process": lambda: stepped(by_hand(True)),
    "by hand": lambda: stepped(by_hand(False)),
    "FMPy": fmpy,
    "first result": first_result,
    "first result of FMPy": first_result_of_fmpy,
    "sweep": sweep,
    "memory, in process": lambda: memory(True),
    "memory": lambda: memory(False),
}

print(SUBJECTS.get(WHAT, other)())
