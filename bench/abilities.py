"""What the abilities of the master cost: traces, rates, real time, saved runs, large systems.

`Abilities.measure` returns costs by name, as bench/measure.py does; times are in ns.
"""

import os
import re
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from hosts import Costs, run
from pendulum_fmus.project import FMUS, ROOT

LOOP = ROOT / "examples" / "closed-loop" / "pid-rbf.toml"
"""The loop that is run with and without an ability: three FMUs, which are called 7 times a step."""

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
        for part in (self.observation, self.rates, self.memory, self.jitter, self.saved):
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
            for share, time in zip(("50", "99", "99.9", "max"), late.groups(), strict=True):
                costs[f"jitter/{name}/{share}"] = [in_ns(time)]
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


def in_ns(text: str) -> float:
    """Return a time that the program prints."""
    value, unit = text.split()
    return float(value) * {"ns": 1.0, "us": 1e3, "ms": 1e6, "s": 1e9}[unit]
