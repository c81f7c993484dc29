"""All measurements: times in ns, in lists with one item per round."""

import json
import os
import platform
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median

from pendulum_fmus.master import Component, System, simulate
from pendulum_fmus.project import FMUS, PROGRAM, ROOT
from subjects import (
    ALL_OUTPUTS,
    BENCH,
    LOOP,
    MODELS,
    PAIR,
    REFERENCE,
    SINE,
    SOURCE,
    VERSIONS,
    Case,
    Host,
    alone,
    by_name,
    in_fmi3,
    run,
    standing,
)

NATIVE = ROOT / "target" / "native" / "cargo-fmu"
CRITERION = ROOT / "target" / "criterion"
SWEEP = ROOT / "examples" / "sweep" / "gains.toml"
SWEPT = ROOT / "examples" / "closed-loop" / "pid-rbf.toml"
CORES = os.cpu_count() or 1
LOOP_STEPS = 2000
"""Steps of one loop of the sweep."""

Rounds = list[float]
Log = Callable[[str], None]


@dataclass(frozen=True)
class Effort:
    """How much is measured, and with which program."""

    program: Path = NATIVE
    rust: bool = True
    """Whether to run the benchmarks in Rust."""
    rounds: int = 500
    """Rounds of cycles, which are short."""
    long_rounds: int = 10
    """Rounds of whole runs and sweeps."""
    instances: int = 10_000
    thread_cycles: int = 500_000
    """Cycles of each thread: so many that the start of the threads does not matter."""
    lengths: Sequence[int] = (1_000, 10_000, 100_000, 1_000_000)
    """Steps of a run."""
    sizes: Sequence[int] = (2, 10, 100, 1000)
    """Numbers of FMUs in a system."""
    system_steps: int = 2_000_000
    """Steps of all FMUs of a system together."""
    sweep: bool = True
    """Whether to run the whole sweep, not a few loops of it."""
    counted: tuple[int, int] = (2_000, 20_000)
    """Lengths of the runs whose difference gives the instructions of a cycle."""


QUICK = Effort(
    PROGRAM, False, 5, 2, 100, 10_000, (1_000, 10_000), (2, 10), 10_000, False, (900, 1_800)
)
"""Shows that everything works; the times mean nothing."""


def measure(effort: Effort, folder: Path, log: Log) -> dict:
    """Measure everything, with temporary files in a folder."""
    results: dict = {"machine": machine(), "program": effort.program.parent.name}
    host = Host(folder)
    log("cycles")
    results["cycle"] = cycles(host, effort)
    results["python"] = against_python(host, effort)
    log("instances, threads")
    moving = [REFERENCE, *(by_name(name) for name in ("Pid", "PidRbf", "Pendulum, linear"))]
    short = max(effort.rounds // 10, 3)
    lives = [*moving, in_fmi3(by_name("PidRbf"))]
    results["life"] = host.measure("life", effort.instances, short // 2 + 1, lives)
    results["many"] = host.measure("many", 20_000, short, moving)
    controllers = moving[:-1]  # the plant would overflow
    results["threads"] = host.measure("threads", effort.thread_cycles, short, controllers)
    log("a coupled pair")
    results["pair"] = pair(host, effort)
    log("runs of several lengths, systems of several sizes")
    results["lengths"] = lengths(effort)
    results["systems"] = systems(effort, folder)
    log("sweeps")
    results["sweeps"] = sweeps(host, effort, folder)
    log("instructions")
    results["counts"] = counts(host, effort.program, *effort.counted)
    if effort.rust:
        log("in process")
        results["rust"] = rust()
    results["sizes"] = {file.stem: file.stat().st_size for file in sorted(FMUS.glob("*.fmu"))}
    return results


def machine() -> dict[str, str | int]:
    """Describe the machine."""
    names: Iterable[str] = ()
    if (info := Path("/proc/cpuinfo")).exists():
        names = re.findall(r"^model name\s*: (.*)$", info.read_text(), re.MULTILINE)
    return {
        "processor": next(iter(names), platform.processor() or "unknown processor"),
        "cores": CORES,
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "rustc": run(["rustc", "--version"]).split(" (")[0].strip(),
        "cc": run([os.environ.get("CC", "cc"), "--version"]).splitlines()[0],
    }


# --- an FMU, from C and in process --------------------------------------------------------

CYCLES = 2000
"""Cycles of one round: so few that the plant, without a controller, is still upright."""


PROCESSES = 20
"""Processes that measure cycles in turn: the addresses of code and data, which differ from
process to process, change the times by up to a tenth."""


def cycles(host: Host, effort: Effort) -> list[dict]:
    """Measure a cycle of each FMU; the reference and PID-RBF twice, for the noise."""
    cases: list[tuple[str, Case]] = []
    for kind in ("stand", "move"):
        models = [REFERENCE, *MODELS, REFERENCE, by_name("PidRbf")]
        models += [ALL_OUTPUTS, *map(in_fmi3, VERSIONS)]
        source = replace(SOURCE, start=SINE if kind == "move" else {})
        of_kind = models if kind == "move" else [standing(case) for case in models]
        cases += [(kind, case) for case in [*of_kind, source]]
    rounds = max(effort.rounds // PROCESSES, 1)
    measured = [case for _, case in cases]
    parts = [host.measure("cycle", CYCLES, rounds, measured) for _ in range(PROCESSES)]
    return [
        {"fmu": case.name, "inputs": kind, "ns": [time for line in of_case for time in line["ns"]]}
        for (kind, case), of_case in zip(cases, zip(*parts, strict=True), strict=True)
    ]


def against_python(host: Host, effort: Effort) -> list[dict]:
    """Measure the PID of PythonFMU and ours in turn; return nothing if it cannot run here."""
    if not host.build_python_fmu():
        return []
    pid = by_name("Pid")
    cases = [pid, replace(pid, name="PythonFMU", model="PythonPid")]
    return host.measure("cycle", CYCLES // 2, max(effort.rounds // 25, 3), cases)


def rust() -> dict[str, dict[str, float]]:
    """Run the benchmarks in Rust; return minimum and median by group and function."""
    brief = ["--noplot", "--warm-up-time", "0.5", "--measurement-time", "1"]
    bench = ["cargo", "bench", "--locked", "--quiet", "--profile", "native"]
    begin = time.time()
    run([*bench, "--package", "fmu-master", "--bench", "speed", "--", *brief])
    results = {}
    for file in CRITERION.glob("*/*/new/sample.json"):
        if file.stat().st_mtime < begin:
            continue  # of a benchmark that no longer exists
        name = json.loads(file.with_name("benchmark.json").read_text())["full_id"]
        sample = json.loads(file.read_text())
        times = [t / n for t, n in zip(sample["times"], sample["iters"], strict=True)]
        results[name] = {"min": min(times), "median": median(times)}
    return results


# --- the native master --------------------------------------------------------------------


def alternate(
    rounds: int, subjects: Mapping[str, Callable[[], float]], tries: int = 1
) -> dict[str, Rounds]:
    """Measure all subjects in turn, in each round; the best of some tries counts."""
    times: dict[str, Rounds] = {name: [] for name in subjects}
    for _ in range(rounds):
        best = dict.fromkeys(subjects, float("inf"))
        for _ in range(tries):
            for name, subject in subjects.items():
                best[name] = min(best[name], subject())
        for name, time_ in best.items():
            times[name].append(time_)
    return times


def natively(program: Path, system: Path, steps: int) -> float:
    """Return the time of a run, without loading and initialization, as the program reports it."""
    stop = 0.001 * (steps + 0.5)  # half a step more, as the last digits of `stop` may be rounded
    text = run([program, "simulate", system, "--stop", f"{stop:.4f}"])
    return 1e6 * float(text.split(" s in ")[1].split(" ms")[0])


def pair(host: Host, effort: Effort) -> dict[str, Rounds]:
    """Measure a step of bench/coupled.toml in each master, and the cycles of its FMUs alone."""
    system = BENCH / "coupled.toml"
    steps, fmpy_steps = (10_000, 1_000) if effort == QUICK else (200_000, 20_000)
    apart = [alone(case) for case in PAIR]

    def own() -> float:
        lines = host.measure("cycle", CYCLES, steps // CYCLES, apart)
        return sum(median(line["ns"]) for line in lines)

    subjects = {
        "own": own,
        "C": lambda: host.measure("loop", steps, 1, PAIR)[0]["ns"][0],
        "native": lambda: natively(effort.program, system, steps) / steps,
        "own again": own,  # for the noise
        "FMPy": lambda: by_fmpy(fmpy_steps) / fmpy_steps,
    }
    return alternate(effort.long_rounds, subjects, tries=3)


def by_fmpy(steps: int) -> float:
    """Return the time of a run with the FMPy master."""
    components = [
        Component("controller", FMUS / "PidRbf.fmu", {"r": 0.01}, sampled=True),
        Component("plant", FMUS / "Pendulum.fmu"),
    ]
    connections = [("plant.theta", "controller.y"), ("controller.u", "plant.u")]
    with System(components, connections) as system:
        begin = time.perf_counter_ns()
        simulate(system, 0.001, 0.001, steps, record=["controller.e"])
        return time.perf_counter_ns() - begin


def lengths(effort: Effort) -> dict[int, Rounds]:
    """Measure a step of the coupled pair in runs of several lengths."""
    system = BENCH / "coupled.toml"
    subjects = {
        str(steps): lambda steps=steps: natively(effort.program, system, steps) / steps
        for steps in effort.lengths
    }
    return alternate(effort.long_rounds, subjects)


def systems(effort: Effort, folder: Path) -> dict[str, dict[str, Rounds]]:
    """Measure systems of several sizes: a step of one FMU, and a command that takes one step."""
    results: dict[str, dict[str, Rounds]] = {}
    files = {size: write_system(folder / f"{size}.toml", size // 2) for size in effort.sizes}
    for _ in range(effort.long_rounds):
        for size, file in files.items():
            steps = effort.system_steps // size
            begin = time.perf_counter_ns()
            first = natively(effort.program, file, 1)
            command = time.perf_counter_ns() - begin
            rest = natively(effort.program, file, steps + 1) - first
            rounds = results.setdefault(str(size), {"step": [], "load": []})
            rounds["step"].append(rest / (steps * size))
            rounds["load"].append(command)
    return results


def write_system(file: Path, loops: int) -> Path:
    """Write a system of closed loops with a PID controller each."""
    connections, components = [], []
    for i in range(loops):
        connections += [f"plant{i}.theta -> controller{i}.y", f"controller{i}.u -> plant{i}.u"]
        for name, model, start in (("controller", "Pid", "r = 0.01"), ("plant", "Pendulum", "")):
            fmu = json.dumps(str(FMUS / f"{model}.fmu"))
            text = f'[[component]]\nname = "{name}{i}"\nfmu = {fmu}\nstart = {{ {start} }}\n'
            components.append(text)
    head = f"start = 0.001\nstop = 1.0\nstep = 0.001\nconnections = {json.dumps(connections)}\n"
    file.write_text(head + 'outputs = ["controller0.e"]\n' + "".join(components), encoding="utf-8")
    return file


def sweeps(host: Host, effort: Effort, folder: Path) -> dict[str, Rounds]:
    """Measure a loop of the sweep in 1, 2, ... processes, and the bare loop in C."""
    text = SWEEP.read_text(encoding="utf-8")
    file = folder / "sweep.toml"
    file.write_text(text if effort.sweep else re.sub(r"count = \d+", "count = 2", text))

    def sweep(processes: int) -> float:
        out = folder / "sweep.csv"
        out.unlink(missing_ok=True)
        options = ["--system", SWEPT, "--threads", str(processes), "--out", out]
        words = run([effort.program, "sweep", file, *options]).split()
        loops, seconds = float(words[0]), float(words[words.index("in") + 1])
        return 1e9 * seconds / loops

    def bare() -> float:
        times = host.measure("loop", LOOP_STEPS, 5 * effort.long_rounds, LOOP)[0]["ns"]
        return LOOP_STEPS * median(times)

    subjects = {"C": bare} | {str(n): lambda n=n: sweep(n) for n in range(1, CORES + 1)}
    return alternate(effort.long_rounds, subjects)


# --- instructions -------------------------------------------------------------------------

Counts = dict[str, float]

WARM_UP = 9 / 8
"""The C host takes an eighth of the cycles before it measures."""


def counts(host: Host, program: Path, fewer: int, more: int) -> dict[str, Counts]:
    """Count instructions, memory accesses and cache misses of a cycle or step with valgrind.

    They are the difference of runs of two lengths, and do not depend on the load of the machine.
    Return nothing if there is no valgrind.
    """
    if not shutil.which("valgrind"):
        return {}
    cases = {"bare PID in C, move": REFERENCE}
    cases |= {f"{name}, move": by_name(name) for name in ("Pid", "PidRbf", "IpidRbf")}
    cases |= {"PidRbf, stand": standing(by_name("PidRbf")), "Pendulum": by_name("Pendulum, linear")}
    cases |= {f"{name}, FMI 3.0, move": in_fmi3(by_name(name)) for name in ("Pid", "PidRbf")}

    def per_step(command: Callable[[int], Sequence[str | Path]]) -> Counts:
        less, all_ = (counted(command(count)) for count in (fewer, more))
        return {name: max(all_[name] - less[name], 0) / (more - fewer) for name in all_}

    def cycle(count: int, name: str) -> list[str]:
        return host.command("cycle", round(count / WARM_UP), 1, [cases[name]])

    def natively(count: int) -> list[str | Path]:
        system = BENCH / "coupled.toml"
        return [program, "simulate", system, "--stop", f"{0.001 * (count + 0.5):.4f}"]

    results = {name: per_step(lambda count, name=name: cycle(count, name)) for name in cases}
    results["the coupled pair, by a master in C"] = per_step(
        lambda n: host.command("loop", n, 1, PAIR)
    )
    results["the coupled pair, natively"] = per_step(natively)
    return results


def counted(command: Sequence[str | Path]) -> Counts:
    """Run a command and count, in the process of it and its children that executes the most."""
    tool = ["valgrind", "--tool=callgrind", "--cache-sim=yes", "--callgrind-out-file=/dev/null"]
    result = subprocess.run(
        [*tool, "--trace-children=yes", *map(str, command)],
        capture_output=True,
        text=True,
        check=True,
    )
    totals = re.findall(r"Collected : ([\d ]+)", result.stderr)
    most = max(([int(number) for number in total.split()] for total in totals), key=lambda t: t[0])
    instructions, reads, writes, _, read_misses, write_misses, *_ = most
    return {
        "instructions": instructions,
        "accesses": reads + writes,
        "misses": read_misses + write_misses,
    }


def say(what: str) -> None:
    """Print the current measurement."""
    print(f"measuring: {what}", file=sys.stderr)
