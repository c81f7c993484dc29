"""The FMUs that are measured, the programs that step them, and all measurements.

Times are in ns, in lists with one item per round.
"""

import json
import os
import platform
import re
import shutil
import subprocess
import sys
import sysconfig
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from importlib.util import find_spec
from math import prod
from pathlib import Path
from statistics import median

import fmpy
from fmpy.model_description import ModelVariable

from pendulum_fmus.master import Component, System, simulate
from pendulum_fmus.project import FMUS, PROGRAM, ROOT

BENCH = ROOT / "bench"


@dataclass(frozen=True)
class Case:
    """An FMU with its inputs, outputs and start values, for the C host."""

    name: str
    model: str
    inputs: Mapping[str, float | str | None] = field(default_factory=dict)
    """A constant, the output FMU.INDEX of another case, or None for a signal that moves."""
    outputs: Sequence[str] = ("u",)
    start: Mapping[str, float | bool] = field(default_factory=dict)


STANDING = {"r": 1.0, "y": 0.99, "d": 0.0, "u_supervisor": 10.0, "u": 1e-4}
"""Inputs that stand. The force is so small that the plant stays upright."""

CONTROLLER = dict.fromkeys(["r", "y", "d"])
FORCE = {"u": None}
SINE = {"signal": 2}

TRANSFER_FUNCTION, LINEAR, NONLINEAR = ({"model": item} for item in (1, 2, 3))
"""The items of the plant's enumeration."""

REFERENCE = Case("bare PID in C", "CPid", CONTROLLER)

MODELS = [
    Case("Pid", "Pid", CONTROLLER),
    Case("PidRbf", "PidRbf", CONTROLLER),
    Case("IpidRbf", "IpidRbf", {**CONTROLLER, "u_supervisor": None}),
    Case("Pendulum, linear", "Pendulum", FORCE, ["theta"], LINEAR),
    Case("Pendulum, nonlinear", "Pendulum", FORCE, ["theta"], NONLINEAR),
    Case("Pendulum, transfer function", "Pendulum", FORCE, ["theta"], TRANSFER_FUNCTION),
]
"""The FMUs of the project with inputs; all move."""

ALL_OUTPUTS = Case(
    "PidRbf, all outputs",
    "PidRbf",
    CONTROLLER,
    ["u", "u_p", "e", "u_n", *(f"rbf.{x}[{i}]" for x in "wh" for i in range(1, 5))],
)
"""The outputs of the network are arrays in FMI 3.0."""

VERSIONS = [*MODELS[:4], ALL_OUTPUTS]
"""The cases that are compared with FMI 3.0."""

SOURCE = Case("Source", "Source", {}, ["r", "d"])

LOOP = [
    Case(
        "controller",
        "PidRbf",
        {"r": "source.0", "y": "plant.0", "d": "source.1"},
        ["u", "e"],
        {"previous_sample_terms": True},
    ),
    Case("plant", "Pendulum", {"u": "controller.0"}, ["theta"]),
    replace(SOURCE, name="source"),
]
"""examples/closed-loop/pid-rbf.toml."""

PAIR = [
    Case("controller", "PidRbf", {"y": "plant.0"}, ["u", "e"], {"r": 0.01}),
    Case("plant", "Pendulum", {"u": "controller.0"}, ["theta"]),
]
"""bench/coupled.toml."""


def by_name(name: str) -> Case:
    """Return a case of the project's FMUs."""
    return next(case for case in MODELS if case.name == name)


def standing(case: Case) -> Case:
    """Return a case with all inputs standing."""
    return replace(case, inputs={name: STANDING[name] for name in case.inputs})


def in_fmi3(case: Case) -> Case:
    """Return a case with the FMU of FMI 3.0, which has whole arrays as outputs."""
    outputs = dict.fromkeys(name.partition("[")[0] for name in case.outputs)
    name, model = f"{case.name}, FMI 3.0", f"{case.model}_fmi3"
    return replace(case, name=name, model=model, outputs=list(outputs))


# --- the C host ---------------------------------------------------------------------------


class Host:
    """The C host of cycle.c in a folder, which unpacks the FMUs that it runs there."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.program = folder / "cycle"
        compiler = os.environ.get("CC", "cc")
        libraries = ["-ldl", "-lm", "-lpthread"]
        run([compiler, "-O2", "-o", self.program, BENCH / "cycle.c", *libraries])
        self._files = {file.stem: file for file in FMUS.glob("*.fmu")}
        run([sys.executable, ROOT / "examples" / "own-fmu" / "build.py", folder])
        self._files["CPid"] = folder / "CPid.fmu"
        self._unpacked: dict[str, tuple[list[str], dict[str, ModelVariable]]] = {}

    def build_python_fmu(self) -> bool:
        """Build the FMU of PythonFMU; return false if it cannot run here."""
        if not python_library() or not find_spec("pythonfmu"):
            return False
        script = BENCH / "python_pid.py"
        run([sys.executable, "-m", "pythonfmu", "build", "-f", script, "-d", self.folder])
        self._files["PythonPid"] = self.folder / "PythonPid.fmu"
        return True

    def measure(self, mode: str, count: int, repeats: int, cases: Sequence[Case]) -> list[dict]:
        """Run a mode of the C host, which measures the cases in turn."""
        in_python = any(case.model == "PythonPid" for case in cases)
        command = self.command(mode, count, repeats, cases)
        lines = run(command, python_environment() if in_python else {})
        return [json.loads(line) for line in lines.splitlines()]

    def command(self, mode: str, count: int, repeats: int, cases: Sequence[Case]) -> list[str]:
        """Return the command that runs a mode of the C host."""
        words = [str(self.program), mode, str(count), str(repeats)]
        for index, case in enumerate(cases):
            words += ["--"] * (index > 0) + self._words(case)
        return words

    def _words(self, case: Case) -> list[str]:
        """Return the arguments that describe a case."""
        if case.model not in self._unpacked:
            self._unpacked[case.model] = unpacked(self._files[case.model], self.folder)
        words, variables = self._unpacked[case.model]

        def reference(name: str) -> str:
            shape = variables[name].shape
            elements = f":{prod(shape)}" if shape else ""
            return f"{variables[name].valueReference}{elements}"

        words = [f"name={case.name}", *words]
        for name, value in case.inputs.items():
            words.append(f"in={reference(name)}" + (f":{value}" if value is not None else ""))
        words += [f"out={reference(name)}" for name in case.outputs]
        types = {"Real": "real", "Float64": "real", "Boolean": "boolean"}
        for name, value in case.start.items():
            kind = types.get(variables[name].type, "integer")
            words.append(f"{kind}={reference(name)}:{float(value)}")
        return words


def unpacked(file: Path, folder: Path) -> tuple[list[str], dict[str, ModelVariable]]:
    """Unpack an FMU; return arguments of the host, from the version to the resources; variables."""
    folder = folder / file.stem
    fmpy.extract(file, str(folder))
    description = fmpy.read_model_description(str(folder), validate=False)
    identifier = description.coSimulation.modelIdentifier
    resources = folder / "resources"
    if description.fmiVersion.startswith("3"):
        fmi, platform, place = 3, fmpy.platform_tuple, f"{resources}{os.sep}"
    else:
        fmi, platform, place = 2, fmpy.platform, resources.as_uri()
    binary = folder / "binaries" / platform / f"{identifier}{fmpy.sharedLibraryExtension}"
    words = [f"fmi={fmi}", f"binary={binary}", f"guid={description.guid}"]
    words += [f"resources={place}"] if resources.is_dir() else []
    return words, {variable.name: variable for variable in description.modelVariables}


def python_library() -> Path | None:
    """Return the shared library of this Python, which PythonFMU's binary needs; None if missing."""
    folder, name = map(sysconfig.get_config_var, ("LIBDIR", "INSTSONAME"))
    library = Path(folder or "", name or "")
    return library if library.is_file() and ".so" in library.name else None


def python_environment() -> dict[str, str]:
    """Return an environment in which PythonFMU's binary finds this Python."""
    return {
        "LD_PRELOAD": str(python_library()),
        "PYTHONHOME": sys.base_prefix,
        "PYTHONPATH": sysconfig.get_path("purelib"),
    }


def run(command: Sequence[str | Path], env: Mapping[str, str] | None = None) -> str:
    """Run a program and return what it prints."""
    words, env = list(map(str, command)), {**os.environ, **(env or {})}
    result = subprocess.run(words, cwd=ROOT, env=env, capture_output=True, text=True, check=False)
    if result.returncode:
        raise SystemExit(f"{command[0]} failed:\n{result.stdout}{result.stderr}")
    return result.stdout


# --- measurements -------------------------------------------------------------------------

NATIVE = ROOT / "target" / "native" / "cargo-fmu"
CRITERION = ROOT / "target" / "criterion"
SWEEP = ROOT / "examples" / "sweep" / "gains.toml"
SWEPT = ROOT / "examples" / "closed-loop" / "pid-rbf.toml"
COUPLED = BENCH / "coupled.toml"
CORES = os.cpu_count() or 1
LOOP_STEPS = 2000
"""Steps of one loop of the sweep."""

Rounds = list[float]


@dataclass(frozen=True)
class Effort:
    """How much is measured, and with which program."""

    program: Path = NATIVE
    full: bool = True
    """Whether to run the benchmarks in Rust, and the whole sweep instead of a few of its loops."""
    rounds: int = 500
    """Rounds of cycles, which are short."""
    long_rounds: int = 10
    """Rounds of whole runs and sweeps."""
    instances: int = 10_000
    thread_cycles: int = 500_000
    """Cycles of each thread: so many that the start of the threads does not matter."""
    pair_steps: tuple[int, int] = (200_000, 20_000)
    """Steps of the coupled pair, natively and by the FMPy master."""
    lengths: Sequence[int] = (1_000, 10_000, 100_000, 1_000_000)
    """Steps of a run."""
    sizes: Sequence[int] = (2, 10, 100, 1000)
    """Numbers of FMUs in a system."""
    system_steps: int = 2_000_000
    """Steps of all FMUs of a system together."""
    counted: tuple[int, int] = (2_000, 20_000)
    """Lengths of the runs whose difference gives the instructions of a cycle."""


QUICK = Effort(
    PROGRAM, False, 5, 2, 100, 10000, (10000, 1000), (1000, 10000), (2, 10), 10000, (900, 1800)
)
"""Shows that everything works; the times mean nothing."""


def measure(effort: Effort, folder: Path) -> dict:
    """Measure everything, with temporary files in a folder."""
    host = Host(folder)
    moving = [REFERENCE, *(by_name(name) for name in ("Pid", "PidRbf", "Pendulum, linear"))]
    lives = [*moving, in_fmi3(by_name("PidRbf"))]
    controllers = moving[:-1]  # the plant would overflow
    short = max(effort.rounds // 10, 3)
    steps = {
        "cycle": lambda: cycles(host, effort),
        "python": lambda: against_python(host, effort),
        "life": lambda: host.measure("life", effort.instances, short // 2 + 1, lives),
        "many": lambda: host.measure("many", 20_000, short, moving),
        "threads": lambda: host.measure("threads", effort.thread_cycles, short, controllers),
        "pair": lambda: pair(host, effort),
        "lengths": lambda: lengths(effort),
        "systems": lambda: systems(effort, folder),
        "sweeps": lambda: sweeps(host, effort, folder),
        "counts": lambda: counts(host, effort.program, *effort.counted),
        "rust": rust,
    }
    results: dict = {"machine": machine(), "program": effort.program.parent.name}
    for name, step in steps.items():
        if effort.full or step is not rust:
            print(f"measuring: {name}", file=sys.stderr)
            results[name] = step()
    results["sizes"] = {file.stem: file.stat().st_size for file in sorted(FMUS.glob("*.fmu"))}
    return results


def machine() -> dict[str, str | int]:
    """Describe the machine."""
    info = Path("/proc/cpuinfo")
    names = re.findall(r"^model name\s*: (.*)$", info.read_text() if info.exists() else "", re.M)
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
    moving = [REFERENCE, *MODELS, REFERENCE, by_name("PidRbf"), ALL_OUTPUTS]
    moving += map(in_fmi3, VERSIONS)
    cases = [("stand", case) for case in [*map(standing, moving), SOURCE]]
    cases += [("move", case) for case in [*moving, replace(SOURCE, start=SINE)]]
    rounds = max(effort.rounds // PROCESSES, 1)
    measured = [case for _, case in cases]
    parts = [host.measure("cycle", CYCLES, rounds, measured) for _ in range(PROCESSES)]
    return [
        {"fmu": case.name, "inputs": kind, "ns": [time for line in of_case for time in line["ns"]]}
        for (kind, case), *of_case in zip(cases, *parts, strict=True)
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
        measured = [[subject() for subject in subjects.values()] for _ in range(tries)]
        for of_subject, tried in zip(times.values(), zip(*measured, strict=True), strict=True):
            of_subject.append(min(tried))
    return times


def simulation(program: Path, system: Path, steps: int) -> list[str | Path]:
    """Return the command that simulates a system natively."""
    stop = 0.001 * (steps + 0.5)  # half a step more, as the last digits of `stop` may be rounded
    return [program, "simulate", system, "--stop", f"{stop:.4f}"]


def natively(program: Path, system: Path, steps: int) -> float:
    """Return the time of a run, without loading and initialization, as the program reports it."""
    return 1e6 * float(run(simulation(program, system, steps)).split(" s in ")[1].split(" ms")[0])


def pair(host: Host, effort: Effort) -> dict[str, Rounds]:
    """Measure a step of bench/coupled.toml in each master, and the cycles of its FMUs alone."""
    steps, fmpy_steps = effort.pair_steps
    # signals instead of the connections
    apart = [replace(case, inputs=dict.fromkeys(case.inputs)) for case in PAIR]

    def own() -> float:
        lines = host.measure("cycle", CYCLES, steps // CYCLES, apart)
        return sum(median(line["ns"]) for line in lines)

    subjects = {
        "own": own,
        "C": lambda: host.measure("loop", steps, 1, PAIR)[0]["ns"][0],
        "native": lambda: natively(effort.program, COUPLED, steps) / steps,
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


def lengths(effort: Effort) -> dict[str, Rounds]:
    """Measure a step of the coupled pair in runs of several lengths."""
    subjects = {
        str(steps): lambda steps=steps: natively(effort.program, COUPLED, steps) / steps
        for steps in effort.lengths
    }
    return alternate(effort.long_rounds, subjects)


def systems(effort: Effort, folder: Path) -> dict[str, dict[str, Rounds]]:
    """Measure systems of several sizes: a step of one FMU, and a command that takes one step."""
    results = {str(size): {"step": [], "load": []} for size in effort.sizes}
    files = {size: write_system(folder / f"{size}.toml", size // 2) for size in effort.sizes}
    for _ in range(effort.long_rounds):
        for size, file in files.items():
            steps = effort.system_steps // size
            begin = time.perf_counter_ns()
            first = natively(effort.program, file, 1)
            results[str(size)]["load"].append(time.perf_counter_ns() - begin)
            rest = natively(effort.program, file, steps + 1) - first
            results[str(size)]["step"].append(rest / (steps * size))
    return results


def write_system(file: Path, loops: int) -> Path:
    """Write a system of closed loops with a PID controller each."""
    connections, text = [], ""
    for i in range(loops):
        connections += [f"plant{i}.theta -> controller{i}.y", f"controller{i}.u -> plant{i}.u"]
        for name, model, start in (("controller", "Pid", "r = 0.01"), ("plant", "Pendulum", "")):
            fmu = json.dumps(str(FMUS / f"{model}.fmu"))
            text += f'[[component]]\nname = "{name}{i}"\nfmu = {fmu}\nstart = {{ {start} }}\n'
    head = f"start = 0.001\nstop = 1.0\nstep = 0.001\nconnections = {json.dumps(connections)}\n"
    file.write_text(f'{head}outputs = ["controller0.e"]\n{text}', encoding="utf-8")
    return file


def sweeps(host: Host, effort: Effort, folder: Path) -> dict[str, Rounds]:
    """Measure a loop of the sweep in 1, 2, ... processes, and the bare loop in C."""
    text, file, out = SWEEP.read_text(encoding="utf-8"), folder / "sweep.toml", folder / "sweep.csv"
    file.write_text(text if effort.full else re.sub(r"count = \d+", "count = 2", text))

    def sweep(processes: int) -> float:
        out.unlink(missing_ok=True)
        options = ["--system", SWEPT, "--threads", str(processes), "--out", out]
        words = run([effort.program, "sweep", file, *options]).split()
        loops, seconds = float(words[0]), float(words[words.index("in") + 1])
        return 1e9 * seconds / loops

    def bare() -> float:
        times = host.measure("loop", LOOP_STEPS, 5 * effort.long_rounds, LOOP)[0]["ns"]
        return LOOP_STEPS * median(times)

    subjects = {"C": bare} | {str(n): partial(sweep, n) for n in range(1, CORES + 1)}
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
    commands = {
        name: lambda n, case=case: host.command("cycle", round(n / WARM_UP), 1, [case])
        for name, case in cases.items()
    }
    commands["the coupled pair, by a master in C"] = lambda n: host.command("loop", n, 1, PAIR)
    commands["the coupled pair, natively"] = partial(simulation, program, COUPLED)
    results = {}
    for name, command in commands.items():
        less, all_ = (counted(command(count)) for count in (fewer, more))
        results[name] = {kind: max(all_[kind] - less[kind], 0) / (more - fewer) for kind in all_}
    return results


def counted(command: Sequence[str | Path]) -> Counts:
    """Run a command and count, in the process of it and its children that executes the most."""
    tool = ["valgrind", "--tool=callgrind", "--cache-sim=yes", "--callgrind-out-file=/dev/null"]
    command = [*tool, "--trace-children=yes", *map(str, command)]
    text = subprocess.run(command, capture_output=True, text=True, check=True).stderr
    totals = [list(map(int, t.split())) for t in re.findall(r"Collected : ([\d ]+)", text)]
    instructions, reads, writes, _, read_misses, write_misses, *_ = max(totals, key=lambda t: t[0])
    misses = read_misses + write_misses
    return {"instructions": instructions, "accesses": reads + writes, "misses": misses}
