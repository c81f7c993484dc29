"""What is measured, and by which programs: costs in ns by name, one for each round."""

import json
import os
import platform
import re
import shutil
import subprocess
import sys
import sysconfig
import time
import tomllib
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from importlib.util import find_spec
from itertools import product
from math import prod
from pathlib import Path
from statistics import median
from typing import Any, Self

import fmpy
from fmpy.model_description import ModelVariable

from pendulum_fmus.master import Component, FmpySystem, simulate
from pendulum_fmus.project import FMUS, PROGRAM, ROOT

BENCH = ROOT / "bench"

Costs = dict[str, list[float]]
"""Times in ns, one per round, by the name of what was measured: "cycle/Pid changing"."""


# --- the FMUs -----------------------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """An FMU with its inputs, outputs and start values, for the C host: a table of cases.toml."""

    name: str
    model: str
    outputs: Sequence[str]
    inputs: Mapping[str, float | str | None] = field(default_factory=dict)
    """A constant, the output FMU.INDEX of another case, or None for a changing signal."""
    start: Mapping[str, float | bool] = field(default_factory=dict)

    @classmethod
    def of(cls, table: Mapping[str, Any]) -> Self:
        """Return the case of a table, in which listed inputs change."""
        inputs = table.get("inputs", {})
        inputs = inputs if isinstance(inputs, Mapping) else dict.fromkeys(inputs)
        return cls(**{**table, "inputs": inputs})


TABLES = tomllib.loads((BENCH / "cases.toml").read_text(encoding="utf-8"))

REFERENCE, ALL_OUTPUTS, SOURCE = (
    Case.of(TABLES[k]) for k in ("reference", "all_outputs", "source")
)

MODELS = {table["name"]: Case.of(table) for table in TABLES["models"]}

LOOP, PAIR = (list(map(Case.of, TABLES[key])) for key in ("loop", "pair"))

BASELINE = [
    replace(MODELS[name], name=f"{name}, baseline", model=f"{name}_baseline")
    for name in ("PidRbf", "IpidRbf")
]
"""The networks without the vectors that are chosen at run time."""

LINEAR = list(MODELS.values())[:4]
"""The controllers and the linear plant."""

VERSIONS = [*LINEAR, ALL_OUTPUTS]
"""The cases that are compared with FMI 3.0."""

COMPILERS = {"cc": os.environ.get("CC", "cc"), "clang": "clang"}
"""The C compilers by their names on the page; those that are installed compile the FMUs in C."""

STANDING = {"r": 1.0, "y": 0.99, "d": 0.0, "u_supervisor": 10.0, "u": 1e-4}
"""Constant inputs. The force is so small that the plant stays upright."""


def standing(case: Case) -> Case:
    """Return a case with constant inputs."""
    return replace(case, inputs={name: STANDING[name] for name in case.inputs})


def in_fmi3(case: Case) -> Case:
    """Return a case with the FMU of FMI 3.0, which has whole arrays as outputs."""
    outputs = dict.fromkeys(name.partition("[")[0] for name in case.outputs)
    name, model = f"{case.name}, FMI 3.0", f"{case.model}_fmi3"
    return replace(case, name=name, model=model, outputs=list(outputs))


IN_C = [version for case in LINEAR for version in (case, in_fmi3(case))]
"""The cases whose FMUs are compiled from their C sources, too."""


def compiled(case: Case, compiler: str) -> Case:
    """Return a case with the FMU that a compiler makes of the C sources."""
    return replace(case, name=f"{case.name}, {compiler}", model=f"{case.model}_{compiler}")


# --- the C host ---------------------------------------------------------------------------


class Host:
    """The C host of cycle.c in a folder, which unpacks the FMUs that it runs there."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.program = folder, folder / "cycle"
        compiler = os.environ.get("CC", "cc")
        libraries = ["-ldl", "-lm", "-lpthread"]
        run([compiler, "-O2", "-o", self.program, BENCH / "cycle.c", *libraries])
        run([sys.executable, ROOT / "examples" / "own-fmu" / "build.py", folder])
        self._unpacked: dict[str, tuple[list[str], dict[str, ModelVariable]]] = {}

    def measure(
        self, mode: str, count: int, repeats: int, cases: Sequence[Case], **env: str
    ) -> list[dict]:
        """Run a mode of the C host, which measures the cases in turn."""
        lines = run(self.command(mode, count, repeats, cases), env)
        return [json.loads(line) for line in lines.splitlines()]

    def command(self, mode: str, count: int, repeats: int, cases: Sequence[Case]) -> list[str]:
        """Return the command that runs a mode of the C host."""
        words = [str(self.program), mode, str(count), str(repeats)]
        for index, case in enumerate(cases):
            words += ["--"] * (index > 0) + self._words(case)
        return words

    def compile(self, case: Case, to: Case, compiler: str, level: str) -> tuple[int, float]:
        """Compile the C sources of a case's FMU to the FMU of another case.

        Return the size of the sources and the seconds that it takes.
        """
        fmu, out = SOURCES / f"{case.model}.fmu", self.folder / f"{to.model}.fmu"
        begin = time.perf_counter()
        options = {"CC": compiler, "CFLAGS": level}
        run([PROGRAM, "build", fmu, "--force", "--out", out], options)
        seconds = time.perf_counter() - begin
        with zipfile.ZipFile(fmu) as archive:
            files = [entry for entry in archive.infolist() if entry.filename.endswith((".c", ".h"))]
        return sum(file.file_size for file in files), seconds

    def _words(self, case: Case) -> list[str]:
        """Return the arguments that describe a case."""
        words, variables = self._unpack(case.model)

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

    def _unpack(self, model: str) -> tuple[list[str], dict[str, ModelVariable]]:
        """Return the arguments from the version to the resources, and the variables."""
        if model in self._unpacked:
            return self._unpacked[model]
        own, folder = self.folder / f"{model}.fmu", self.folder / model
        fmpy.extract(own if own.exists() else FMUS / own.name, str(folder))
        description = fmpy.read_model_description(str(folder), validate=False)
        resources = folder / "resources"
        fmi, tuple_, place = 2, fmpy.platform, resources.as_uri()
        if description.fmiVersion.startswith("3"):
            fmi, tuple_, place = 3, fmpy.platform_tuple, f"{resources}{os.sep}"
        library = f"{description.coSimulation.modelIdentifier}{fmpy.sharedLibraryExtension}"
        words = [f"fmi={fmi}", f"binary={folder / 'binaries' / tuple_ / library}"]
        words += [f"guid={description.guid}", *[f"resources={place}"] * resources.is_dir()]
        variables = {variable.name: variable for variable in description.modelVariables}
        self._unpacked[model] = words, variables
        return words, variables


def run(
    command: Sequence[object], env: Mapping[str, str] | None = None, given: str | None = None
) -> str:
    """Run a program with an input and return what it prints."""
    words, env = list(map(str, command)), {**os.environ, **(env or {})}
    options: Any = {"cwd": ROOT, "env": env, "input": given}
    result = subprocess.run(words, **options, capture_output=True, text=True, check=False)
    if result.returncode:
        raise SystemExit(f"{command[0]} failed:\n{result.stdout}{result.stderr}")
    return result.stdout


# --- measurements -------------------------------------------------------------------------

NATIVE = ROOT / "target" / "native" / "cargo-fmu"
MATRIX = ROOT / "tests" / "matrix"
CRITERION = ROOT / "target" / "criterion"
SWEEP = ROOT / "examples" / "sweep" / "gains.toml"
SWEPT = ROOT / "examples" / "closed-loop" / "pid-rbf.toml"
COUPLED = BENCH / "coupled.toml"
PACKAGE = ROOT / "crates" / "fmu-python" / "python" / "fmu_master"
LIBRARY = {"darwin": "lib_native.dylib"}.get(sys.platform, "lib_native.so")
WASM = ROOT / "target" / "wasm"
SOURCES = ROOT / "target" / "sources"
CORES = os.cpu_count() or 1

MASTERS = {
    "simulate, in process": 200_000,
    "simulate": 200_000,
    "by hand, in process": 20_000,
    "by hand": 2_000,
    "FMPy": 20_000,
    "libcosim": 5_000,
    "ecos": 20_000,
    "fmuloader": 5_000,
}
"""Steps of a run by each master that is called from Python, a name of bench/from_python.py. With
many more, the loop in parallel order diverges."""

OTHERS = {"libcosim": "libcosimpy", "ecos": "ecospy", "fmuloader": "fmuloader"}
"""The packages of other masters."""

FIRST = ("first result", "first result of FMPy")

LOOPS = 100_000
"""Loops after which the memory is measured; before, after a tenth of them."""

LOOP_STEPS = 2000
"""Steps of one loop of the sweep."""

CYCLES = 2000
"""Cycles of one round: so few that the plant, without a controller, is still upright."""

PROCESSES = 20
"""Processes that measure cycles in turn: the addresses of code and data, which differ from
process to process, change the times by up to a tenth."""

WARM_UP = 9 / 8
"""The C host takes an eighth of the cycles before it measures."""


class Bench:
    """All measurements, with temporary files in a folder.

    If `quick`, they only show that they work, with the program of `make fmus`: the times mean
    nothing.
    """

    def __init__(self, folder: Path, *, quick: bool = False):
        self.folder, self.quick, self.host = folder, quick, Host(folder)
        self.program = PROGRAM if quick else NATIVE
        self.rounds = 2 if quick else 10
        """Rounds of whole runs and sweeps; the C host has more."""
        self.bytes: dict[str, float] = {}
        self.in_c: dict[str, dict[str, float]] = {}
        """Of each FMU's C sources: their size, the seconds to build them, an instance's size."""
        self.packages = folder / "packages"
        """The Python module with the fast native part."""
        shutil.copytree(
            PACKAGE, self.packages / PACKAGE.name, ignore=lambda *_: ["_native.abi3.so"]
        )
        built = self.program.parent / LIBRARY
        (self.packages / PACKAGE.name / "_native.abi3.so").symlink_to(built)

    def some(self, count: int) -> int:
        """Return a number of repetitions, or much less."""
        return max(count // 100, 3) if self.quick else count

    def measure(self) -> dict:
        """Measure everything."""
        parts = [self.cycles, self.python, self.lives, self.instances, self.threads]
        parts += [self.pair, self.whole, self.lengths, self.systems, self.sweeps]
        parts += [self.masters, self.module, self.memory]
        parts += [rust] * (not self.quick)
        costs: Costs = {}
        for part in parts:
            print(f"measuring: {part.__name__}", file=sys.stderr)
            costs |= part()
        return {
            "machine": machine(),
            "quick": self.quick,
            "costs": costs,
            "counts": self.counts(),
            "bytes": self.bytes,
            "in_c": self.in_c,
            "compile": {} if self.quick else compile_times(self.folder / "cold"),
            "sizes": {file.stem: file.stat().st_size for file in sorted(FMUS.glob("*.fmu"))},
        }

    # --- an FMU, from C

    def cycles(self) -> Costs:
        """Measure a cycle of each FMU; the reference and PID-RBF twice, for the noise."""
        moving = [REFERENCE, *MODELS.values(), ALL_OUTPUTS, *map(in_fmi3, VERSIONS)]
        moving += self.baseline()
        in_c = self.compile_sources()
        again = [replace(case, name=f"{case.name} again") for case in (REFERENCE, MODELS["PidRbf"])]
        sine = replace(SOURCE, start={"signal": 2})
        cases = [(case, "constant") for case in [*map(standing, [*moving, *again]), SOURCE]]
        cases += [(case, "changing") for case in [*moving, *again, sine, *in_c]]
        rounds, measured = max(self.some(500) // PROCESSES, 1), [case for case, _ in cases]
        parts = [self.host.measure("cycle", CYCLES, rounds, measured) for _ in range(PROCESSES)]
        return {
            f"cycle/{case.name} {inputs}": [time for line in lines for time in line["ns"]]
            for (case, inputs), *lines in zip(cases, *parts, strict=True)
        }

    def baseline(self) -> list[Case]:
        """Export the networks with the vectors that every processor of the platform has."""
        out = self.folder / "baseline"
        command = [PROGRAM, "export", "--package", "fmu-controller", "--no-default-features"]
        run([*command, "--out", out])
        for case in BASELINE:
            name = f"{case.model.removesuffix('_baseline')}.fmu"
            (out / name).rename(self.folder / f"{case.model}.fmu")
        return BASELINE

    def compile_sources(self) -> list[Case]:
        """Compile the C sources of FMUs with each compiler; return the cases with the results."""
        compilers = {name: path for name, path in COMPILERS.items() if shutil.which(path)}
        cases, found, level = IN_C, [], "-O2"
        if self.quick:
            compilers, cases, level = {"cc": COMPILERS["cc"]}, cases[:2], "-O0"
        for case in cases:
            of = self.in_c[case.model] = {}
            for compiler, path in compilers.items():
                found.append(compiled(case, compiler))
                of["text"], of[compiler] = self.host.compile(case, found[-1], path, level)
            [line] = self.host.measure("life", 10, 1, found[-1:])
            of["instance"] = line["initialized_bytes"]
        return found

    def python(self) -> Costs:
        """Measure the PID of PythonFMU and ours in turn; nothing if it cannot run here."""
        parts = map(sysconfig.get_config_var, ("LIBDIR", "INSTSONAME"))
        library = Path(*(part or "" for part in parts))  # which PythonFMU's binary needs
        if not library.is_file() or ".so" not in library.name or not find_spec("pythonfmu"):
            return {}
        script = BENCH / "python_pid.py"
        run([sys.executable, "-m", "pythonfmu", "build", "-f", script, "-d", self.folder])
        paths = {"PYTHONHOME": sys.base_prefix, "PYTHONPATH": sysconfig.get_path("purelib")}
        cases = [MODELS["Pid"], replace(MODELS["Pid"], model="PythonPid")]
        count, rounds = CYCLES // 2, self.some(20)
        lines = self.host.measure("cycle", count, rounds, cases, LD_PRELOAD=str(library), **paths)
        return {f"python/{case.model}": line["ns"] for case, line in zip(cases, lines, strict=True)}

    def lives(self) -> Costs:
        """Measure from instantiation to the end, and the memory of an instance."""
        cases = [REFERENCE, MODELS["Pid"], MODELS["PidRbf"], MODELS["Pendulum, linear"]]
        cases.append(in_fmi3(MODELS["PidRbf"]))
        count, costs = self.some(10_000), {}
        # A process each: instances take longer on the heap that those of another FMU leave.
        for _, case in product(range(PROCESSES), cases):
            [line] = self.host.measure("life", count, self.some(50) // PROCESSES + 1, [case])
            self.bytes[case.name] = line["initialized_bytes"]
            costs.setdefault(f"life/{case.name}", []).extend(line["ns"])
        return costs

    def instances(self) -> Costs:
        """Measure a cycle of many instances that are stepped in turn."""
        cases = [REFERENCE, MODELS["Pid"], MODELS["PidRbf"], MODELS["Pendulum, linear"]]
        lines = self.host.measure("many", 20_000, self.some(50), cases)
        return {f"instances/{line['fmu']}/{line['instances']}": line["ns"] for line in lines}

    def threads(self) -> Costs:
        """Measure a cycle in several threads; the plant would overflow in so many cycles."""
        cases = [REFERENCE, MODELS["Pid"], MODELS["PidRbf"]]
        # The start of the threads must not matter
        lines = self.host.measure("threads", self.some(500_000), self.some(50), cases)
        return {f"threads/{line['fmu']}/{line['threads']}": line["ns"] for line in lines}

    # --- the masters

    def alternate(self, subjects: Mapping[str, Callable[[], float]], tries: int = 1) -> Costs:
        """Measure all subjects in turn, in each round; the best of some tries counts."""
        times: Costs = {name: [] for name in subjects}
        for _ in range(self.rounds):
            measured = [[subject() for subject in subjects.values()] for _ in range(tries)]
            for of_subject, tried in zip(times.values(), zip(*measured, strict=True), strict=True):
                of_subject.append(min(tried))
        return times

    def simulation(self, system: Path, steps: int) -> list[str | Path]:
        """Return the command that simulates a system natively."""
        stop = 0.001 * (steps + 0.5)  # half a step more, as the last digits may be rounded
        return [self.program, "simulate", system, "--stop", f"{stop:.4f}"]

    def natively(self, system: Path, steps: int) -> float:
        """Return the time of a run, without loading and initialization, as the program reports."""
        return reported(run(self.simulation(system, steps)))

    def pair(self) -> Costs:
        """Measure a step of bench/coupled.toml in each master, and the cycles of its FMUs alone."""
        steps, few = self.some(200_000), self.some(20_000)
        # signals instead of the connections
        apart = [replace(case, inputs=dict.fromkeys(case.inputs)) for case in PAIR]

        def own() -> float:
            lines = self.host.measure("cycle", CYCLES, steps // CYCLES, apart)
            return sum(median(line["ns"]) for line in lines)

        text = COUPLED.read_text(encoding="utf-8")
        components = self.folder / "components.toml"
        text = re.sub(r"\.\./target/fmu/(\w+)", rf"{WASM.as_posix()}/\1_fmi3", text)
        components.write_text(text, encoding="utf-8")
        subjects = {
            "pair/own": own,
            "pair/C": lambda: self.host.measure("loop", steps, 1, PAIR)[0]["ns"][0],
            "pair/native": lambda: self.natively(COUPLED, steps) / steps,
            "pair/own again": own,  # for the noise
            "pair/FMPy": lambda: by_fmpy(few) / few,
            "pair/script": lambda: by_script(few) / few,
        }
        if not self.quick:  # its program has no wasmtime
            subjects["pair/wasmtime"] = lambda: self.natively(components, few) / few
        return self.alternate(subjects, tries=3)

    def whole(self) -> Costs:
        """Measure a run of 20 s of the coupled pair, from start to end, and its steps."""
        command, costs = self.simulation(COUPLED, 20_000), {"run/all": [], "run/steps": []}
        for _ in range(self.rounds):
            begin = time.perf_counter_ns()
            steps = run(command)
            costs["run/all"].append(time.perf_counter_ns() - begin)
            costs["run/steps"].append(reported(steps))
        return costs

    def lengths(self) -> Costs:
        """Measure a step of the coupled pair in runs of several lengths."""
        lengths = (1_000, 10_000, 100_000, 1_000_000)[: 2 if self.quick else None]
        return self.alternate(
            {f"length/{n}": lambda n=n: self.natively(COUPLED, n) / n for n in lengths}
        )

    def systems(self) -> Costs:
        """Measure systems of several sizes: a step of one FMU, and a command with one step."""
        sizes, costs = (2, 10, 100, 1000)[: 2 if self.quick else None], {}
        files = {size: write_system(self.folder / f"{size}.toml", size // 2) for size in sizes}
        for _ in range(self.rounds):
            for size, file in files.items():
                steps, begin = self.some(2_000_000) // size, time.perf_counter_ns()
                first = self.natively(file, 1)
                load = time.perf_counter_ns() - begin
                rest = self.natively(file, steps + 1) - first
                costs.setdefault(f"load/{size}", []).append(load)
                costs.setdefault(f"step/{size}", []).append(rest / (steps * size))
        return costs

    def sweep_file(self, stop: float) -> Path:
        """Write the file of the sweep with another stop time [s]."""
        text = SWEEP.read_text(encoding="utf-8").replace("stop = 2.0", f"stop = {stop}")
        text = text.replace('"..', f'"{SWEEP.parents[1]}')
        file = self.folder / "sweep.toml"
        file.write_text(re.sub(r"count = \d+", "count = 2", text) if self.quick else text)
        return file

    def sweeps(self) -> Costs:
        """Measure a loop of the sweep in 1, 2, ... processes, and the bare loop in C."""
        file, out = self.sweep_file(2.0), self.folder / "sweep.csv"

        def sweep(processes: int) -> float:
            out.unlink(missing_ok=True)
            options = ["--system", SWEPT, "--threads", str(processes), "--out", out]
            words = run([self.program, "sweep", file, *options]).split()
            loops, seconds = float(words[0]), float(words[words.index("in") + 1])
            return 1e9 * seconds / loops

        def bare() -> float:
            times = self.host.measure("loop", LOOP_STEPS, 5 * self.rounds, LOOP)[0]["ns"]
            return LOOP_STEPS * median(times)

        counts = {f"sweep/{n}": partial(sweep, n) for n in range(1, CORES + 1)}
        return self.alternate({"sweep/C": bare} | counts)

    # --- from Python

    def from_python(self, what: str, count: int, folder: Path = FMUS) -> float:
        """Return what bench/from_python.py prints."""
        paths = {"PYTHONPATH": os.pathsep.join(map(str, [self.packages, ROOT / "python", MATRIX]))}
        return float(
            run([sys.executable, BENCH / "from_python.py", what, folder, str(count)], paths)
        )

    def masters(self) -> Costs:
        """Measure a step of a loop of three FMUs by each master that can be called here."""
        subjects = {}
        for name, steps in MASTERS.items():
            load = [sys.executable, "-c", f"import {OTHERS.get(name, 'sys')}"]
            # Ecos needs a library of the system.
            if subprocess.run(load, capture_output=True, check=False).returncode == 0:
                subjects[f"master/{name}"] = partial(self.from_python, name, self.some(steps))
        return self.alternate(subjects)

    def module(self) -> Costs:
        """Measure from the import to the first result, and a sweep in 1 and 2 processes."""
        file = self.sweep_file(8.0)  # long runs, as starting Python is not to count
        subjects = {f"first/{name}": partial(self.from_python, name, 1) for name in FIRST}
        subjects |= {f"module/{n}": partial(self.from_python, "sweep", n, file) for n in (1, 2)}
        return self.alternate(subjects)

    def memory(self) -> Costs:
        """Measure the memory [bytes] after many short runs of a loop."""
        kinds, counts = ("memory, in process", "memory"), (LOOPS // 10, LOOPS)
        return {
            f"{kind}/{count}": [self.from_python(kind, self.some(count))]
            for kind, count in product(kinds, counts)
        }

    # --- instructions

    def counts(self) -> dict[str, dict[str, float]]:
        """Count instructions, memory accesses and cache misses of a cycle or step with valgrind.

        They are the difference of runs of two lengths, and do not depend on the load of the
        machine. Return nothing if there is no valgrind.
        """
        if not shutil.which("valgrind"):
            return {}
        pid, rbf, ipid = (MODELS[name] for name in ("Pid", "PidRbf", "IpidRbf"))
        plant = replace(MODELS["Pendulum, linear"], name="Pendulum")
        cases = {f"{c.name}, changing inputs": c for c in (REFERENCE, pid, rbf, ipid)}
        cases |= {"PidRbf, constant inputs": standing(rbf), "Pendulum": plant}
        cases |= {f"{c.name}, changing inputs": c for c in map(in_fmi3, (pid, rbf))}
        commands = {
            name: lambda n, case=case: self.host.command("cycle", round(n / WARM_UP), 1, [case])
            for name, case in cases.items()
        }
        commands["the coupled pair, by a master in C"] = partial(
            self.host.command, "loop", repeats=1, cases=PAIR
        )
        commands["the coupled pair, natively"] = partial(self.simulation, COUPLED)
        if self.quick:
            commands = dict([*commands.items()][-2:-1])  # the program takes long in valgrind
        fewer, more = (900, 1_800) if self.quick else (2_000, 20_000)
        results = {}
        for name, command in commands.items():
            less, all_ = (counted(command(count)) for count in (fewer, more))
            results[name] = {
                kind: max(all_[kind] - less[kind], 0) / (more - fewer) for kind in all_
            }
        return results


VECTORS = {"avx512f": "AVX-512", "avx2": "AVX2", "sse2": "SSE2"}
"""Vector instructions by the flag of the processor, the longest vectors first."""


def machine() -> dict[str, str | int]:
    """Describe the machine."""
    info = Path("/proc/cpuinfo")
    text = info.read_text() if info.exists() else ""
    names = re.findall(r"^model name\s*: (.*)$", text, re.M)
    flags = next(iter(re.findall(r"^flags\s*: (.*)$", text, re.M)), "").split()
    found = (name for flag, name in VECTORS.items() if flag in flags)
    return {
        "vectors": next(found, "the vector instructions of the platform"),
        "processor": next(iter(names), platform.processor() or "unknown processor"),
        "cores": CORES,
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "rustc": run(["rustc", "--version"]).split(" (")[0].strip(),
        "cc": run([os.environ.get("CC", "cc"), "--version"]).splitlines()[0],
    }


def rust() -> Costs:
    """Run the benchmarks in Rust; their names begin with "in process/", "nodes/" or "loading/"."""
    brief = ["--noplot", "--warm-up-time", "0.5", "--measurement-time", "1"]
    bench = ["cargo", "bench", "--locked", "--quiet", "--profile", "native"]
    begin, costs = time.time(), {}
    # The program for components is built again, with wasmtime.
    bench += ["--package", "bench", "--features", "sandbox", "--bench", "speed"]
    run([*bench, "--", *brief])
    for file in CRITERION.glob("*/*/new/sample.json"):
        if file.stat().st_mtime < begin:
            continue  # of a benchmark that no longer exists
        name = json.loads(file.with_name("benchmark.json").read_text())["full_id"]
        sample = json.loads(file.read_text())
        costs[name] = [t / n for t, n in zip(sample["times"], sample["iters"], strict=True)]
    return costs


def reported(text: str) -> float:
    """Return the time (ns) that a simulation took, from what it prints."""
    return 1e6 * float(text.split(" s in ")[1].split(" ms")[0])


def compile_times(folder: Path) -> dict[str, float]:
    """Compile what `make demo` compiles first, in an empty folder; return seconds by crate."""
    words = ["cargo", "build", "--quiet", "--locked", "--no-default-features", "--timings"]
    words += ["--package", "fmu-build", "--example", "export"]
    run([*words, "--target-dir", folder])
    text = (folder / "cargo-timings" / "cargo-timing.html").read_text(encoding="utf-8")
    found = re.search(r"^const UNIT_DATA = (\[.*?\]);$", text, re.MULTILINE | re.DOTALL)
    seconds: dict[str, float] = {}
    for unit in json.loads(found[1]) if found else []:
        seconds[unit["name"]] = seconds.get(unit["name"], 0.0) + unit["duration"]
    return dict(sorted(seconds.items(), key=lambda item: -item[1]))


def by_fmpy(steps: int) -> float:
    """Return the time of a run of the coupled pair with the FMPy master."""
    components = [
        Component("controller", FMUS / "PidRbf.fmu", {"r": 0.01}, sampled=True),
        Component("plant", FMUS / "Pendulum.fmu"),
    ]
    connections = [("plant.theta", "controller.y"), ("controller.u", "plant.u")]
    with FmpySystem(components, connections) as system:
        begin = time.perf_counter_ns()
        simulate(system, 0.001, 0.001, steps, record=["controller.e"])
        return time.perf_counter_ns() - begin


def by_script(steps: int) -> float:
    """Return the time of the same run, with a call of FMPy for each value and step."""
    unpacked, slaves, references = [], [], []
    for model in ("PidRbf", "Pendulum"):
        description = fmpy.read_model_description(FMUS / f"{model}.fmu")
        unpacked.append(fmpy.extract(FMUS / f"{model}.fmu"))
        slaves.append(fmpy.instantiate_fmu(unpacked[-1], description, "CoSimulation"))
        references.append({v.name: [v.valueReference] for v in description.modelVariables})
    (controller, plant), (own, others), errors = slaves, references, []
    controller.setReal(own["r"], [0.01])
    for slave in slaves:
        slave.setupExperiment(startTime=0.001)
        slave.enterInitializationMode()
        slave.exitInitializationMode()
    begin = time.perf_counter_ns()
    for k in range(1, steps + 1):
        controller.setReal(own["y"], plant.getReal(others["theta"]))
        controller.doStep(0.001 * k, 0.001)
        plant.setReal(others["u"], controller.getReal(own["u"]))
        plant.doStep(0.001 * k, 0.001)
        errors.append(controller.getReal(own["e"])[0])
    duration = time.perf_counter_ns() - begin
    for slave, folder in zip(slaves, unpacked, strict=True):
        slave.freeInstance()
        shutil.rmtree(folder)
    return duration


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


def counted(command: Sequence[str | Path]) -> dict[str, int]:
    """Run a command and count, in the process of it and its children that executes the most."""
    tool = ["valgrind", "--tool=callgrind", "--cache-sim=yes", "--callgrind-out-file=/dev/null"]
    command = [*tool, "--trace-children=yes", *map(str, command)]
    text = subprocess.run(command, capture_output=True, text=True, check=True).stderr
    totals = [list(map(int, t.split())) for t in re.findall(r"Collected : ([\d ]+)", text)]
    instructions, reads, writes, _, read_misses, write_misses, *_ = max(totals)
    misses = read_misses + write_misses
    return {"instructions": instructions, "accesses": reads + writes, "misses": misses}
