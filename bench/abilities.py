"""What the abilities of the master cost: traces, rates, real time, stiff equations, containers.

`Abilities.measure` returns costs by name, as bench/measure.py does; times are in ns.
"""

import csv
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import fmpy

from hosts import Costs, run
from pendulum_fmus.project import FMUS, ROOT

LOOP = ROOT / "examples" / "closed-loop" / "pid-rbf.toml"
"""The loop that is run with and without an ability: three FMUs, which are called 8 times a step."""

ROBERTSON = {"a": 0.7158270687193941, "b": 9.185534764557e-6, "c": 0.2841637457458413}
"""The solution of Robertson's problem at 40 s (Hairer and Wanner, Solving ODEs II, IV.10)."""

BUSY = [sys.executable, "-c", "while True: pass"]
"""A process that keeps a core busy."""


class Abilities:
    """Measures by the command line, with temporary files in a folder."""

    def __init__(self, program: Path, folder: Path, *, quick: bool):
        self.program, self.folder, self.quick = program, folder, quick
        self.rounds = 1 if quick else 5

    def measure(self) -> Costs:
        """Measure everything."""
        costs: Costs = {}
        parts = [self.observation, self.rates, self.memory, self.jitter]
        if not self.quick:  # what these measure takes long to build
            parts += [self.stiff, self.container]
        for part in parts:
            costs |= part()
        return costs

    def simulate(self, system: Path, steps: int, *options: object) -> str:
        """Return what a run of so many steps of a millisecond prints."""
        stop = f"{0.001 * (steps + 0.5):.4f}"
        return run([self.program, "simulate", system, "--stop", stop, *options])

    def step(self, system: Path, steps: int, *options: object) -> float:
        """Return the time of a step in a run."""
        text = self.simulate(system, steps, *options)
        return 1e6 * float(text.split(" s in ")[1].split(" ms")[0]) / steps

    def observation(self) -> Costs:
        """Measure a step that is observed: in a profile, and in a trace."""
        steps, trace = 200 if self.quick else 20_000, self.folder / "trace"
        ways: dict[str, Sequence[object]] = {
            "plain": [],
            "profile": ["--profile"],
            "trace": ["--trace", trace],
        }
        costs: Costs = {f"step/{way}": [] for way in ways}
        for _ in range(self.rounds):
            for way, options in ways.items():
                costs[f"step/{way}"].append(self.step(LOOP, steps, *options))
        return costs | {"trace/size": [trace.stat().st_size / steps]}

    def rates(self) -> Costs:
        """Measure a plant ten times as fast as its controller, and both as fast as the plant."""
        steps = 100 if self.quick else 10_000
        pair = (ROOT / "bench" / "coupled.toml").read_text(encoding="utf-8")
        pair = pair.replace("../target/fmu", FMUS.as_posix())
        plant = re.compile(r'(name = "plant"\n)')
        fine = pair.replace("step = 0.001", "step = 0.0001")
        own = plant.sub(r"\1step = 0.0001\n", pair)
        costs: Costs = {}
        for name, text in (("rate/own", own), ("rate/all", fine)):
            assert text != pair
            file = self.folder / f"{name.replace('/', '-')}.toml"
            file.write_text(text, encoding="utf-8")
            costs[name] = [self.step(file, steps) for _ in range(self.rounds)]
        return costs

    def memory(self) -> Costs:
        """Measure the memory [bytes] of short and long runs, with a trace and in real time."""
        costs: Costs = {}
        for name, steps in (("short", 1_000), ("long", 10_000 if self.quick else 200_000)):
            options = ["--csv", os.devnull, "--trace", self.folder / "trace"]
            command = [self.program, "simulate", LOOP, "--stop", f"{0.001 * steps}", *options]
            process = subprocess.Popen(list(map(str, command)), stdout=subprocess.DEVNULL)
            _, status, used = os.wait4(process.pid, 0)
            assert status == 0
            costs[f"memory/{name}"] = [1024.0 * used.ru_maxrss]
        return costs

    def stiff(self) -> Costs:
        """Measure Robertson's problem by the implicit method, and by CVODE as FMPy has it."""
        run([self.program, "export", "--package", "stiff", "--out", self.folder])
        fmu, stop, tolerance = self.folder / "Robertson.fmu", 40.0, 1e-6
        out = self.folder / "stiff.csv"
        options = ["--interface", "model-exchange", "--solver", "implicit", "--csv", out]
        options += ["--stop", stop, "--step", stop, "--tolerance", tolerance]
        costs: Costs = {"stiff/ours": [], "stiff/CVODE": []}
        for _ in range(self.rounds):
            begin = time.perf_counter_ns()
            run([self.program, "simulate", fmu, *options])
            costs["stiff/ours"].append(time.perf_counter_ns() - begin)
            begin = time.perf_counter_ns()
            by_cvode = fmpy.simulate_fmu(
                str(fmu),
                fmi_type="ModelExchange",
                stop_time=stop,
                output_interval=stop / 200,  # with a longer one, its CVODE gives up
                relative_tolerance=tolerance,
            )
            costs["stiff/CVODE"].append(time.perf_counter_ns() - begin)
        with out.open(encoding="utf-8", newline="") as file:
            *_, last = csv.DictReader(file)
        ours = {name.split(" ")[0]: float(value) for name, value in last.items()}
        costs["stiff/ours error"] = [error(ours)]
        costs["stiff/CVODE error"] = [error({name: by_cvode[name][-1] for name in ROBERTSON})]
        return costs

    def container(self) -> Costs:
        """Measure a step of the loop as one FMU."""
        fmu = self.folder / "Loop.fmu"
        run([self.program, "pack", LOOP, "--out", fmu])
        steps = 200 if self.quick else 20_000
        return {"container/FMU": [self.step(fmu, steps) for _ in range(self.rounds)]}

    def jitter(self) -> Costs:
        """Measure how late a run in real time wakes up, while the machine is quiet and busy."""
        steps = 100 if self.quick else 20_000
        numbers = r"50 % (.*?), 99 % (.*?), 99.9 % (.*?), maximum (.*?) at"
        costs: Costs = {}
        for name, count in (("quiet", 0), ("busy", 2 * (os.cpu_count() or 1))):
            with busy(count):
                text = self.simulate(LOOP, steps, "--real-time")
            late = re.search(numbers, text)
            assert late, text
            for share, late_by in zip(("50", "99", "99.9", "max"), late.groups(), strict=True):
                costs[f"jitter/{name}/{share}"] = [in_ns(late_by)]
        return costs


@contextmanager
def busy(count: int) -> Iterator[None]:
    """Keep so many processes busy."""
    processes = [subprocess.Popen(BUSY) for _ in range(count)]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


def error(found: Mapping[str, float]) -> float:
    """Return the largest relative error of a solution of Robertson's problem."""
    return max(abs(found[name] / value - 1) for name, value in ROBERTSON.items())


def in_ns(text: str) -> float:
    """Return a time that the program prints."""
    value, unit = text.split()
    return float(value) * {"ns": 1.0, "us": 1e3, "ms": 1e6, "s": 1e9}[unit]
