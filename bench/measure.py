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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from itertools import product
from multiprocessing.pool import ThreadPool
from pathlib import Path
from statistics import median
from typing import Any

import fmpy_script
from hosts import (
    ALL_OUTPUTS,
    BASELINE,
    BENCH,
    CALL,
    COMPILERS,
    IN_C,
    LOOP,
    MODELS,
    NATIVE,
    PAIR,
    REFERENCE,
    VERSIONS,
    Case,
    Costs,
    Host,
    compiled,
    in_fmi3,
    in_host,
    run,
    standing,
)
from pendulum_fmus.project import FMUS, PROGRAM, ROOT

MATRIX = ROOT / "tests" / "matrix"
SWEEP = ROOT / "examples" / "sweep" / "gains.toml"
SWEPT = ROOT / "examples" / "closed-loop" / "pid-rbf.toml"
COUPLED = BENCH / "coupled.toml"
PACKAGE = ROOT / "crates" / "fmu-python" / "python" / "fmu_master"
LIBRARY = {"darwin": "lib_native.dylib"}.get(sys.platform, "lib_native.so")
WASM = ROOT / "target" / "wasm"
CORES = os.cpu_count() or 1

CALLS = {
    "call/Instance, in process": 100_000,
    "call/Instance": 20_000,
    "call/FMPy": 20_000,
    "call/simulate, in process": 1_000_000,
    "call/simulate": 1_000_000,
    "call/simulate_fmu": 10_000,
}
"""Steps of one FMU by each kind of call from Python, a name of bench/from_python.py."""

MASTERS = {
    "master/simulate, in process": 200_000,
    "master/simulate": 200_000,
    "master/Instance, in process": 20_000,
    "master/Instance": 2_000,
    "master/FMPy": 20_000,
    "master/ours on FMPy": 20_000,
    "master/libcosim": 5_000,
    "master/ecos": 20_000,
    "master/fmuloader": 5_000,
}
"""Steps of a run by each master that is called from Python, likewise. With many more, the loop in
parallel order diverges."""

OTHERS = {
    "master/libcosim": "libcosimpy",
    "master/ecos": "ecospy",
    "master/fmuloader": "fmuloader",
}
"""The packages of other masters."""

SIZES = (16, 256, 4096)
"""Numbers of environments of a vector."""

ROWS = 10_000_000
"""Rows of the result that is plotted."""

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
        self.few_rounds = 1 if quick else 5
        """Rounds of what starts Python."""
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
        parts = [self.cycles, self.threads, self.calls, self.pair, self.systems, self.sweeps]
        parts += [self.masters, self.module, self.environments, self.plots]
        parts += [self.samples] * (not self.quick)
        costs: Costs = {}
        for part in parts:
            begin = time.perf_counter()
            costs |= part()
            print(f"{part.__name__}: {time.perf_counter() - begin:.0f} s", file=sys.stderr)
        return {
            "machine": machine(),
            "quick": self.quick,
            "costs": costs,
            "counts": self.counts(),
        }

    # --- an FMU, from C

    def cycles(self) -> Costs:
        """Measure a cycle of each FMU; the reference and PID-RBF twice, for the noise."""
        moving = [REFERENCE, *MODELS.values(), ALL_OUTPUTS, *map(in_fmi3, VERSIONS)]
        moving.append(self.baseline())
        in_c = self.compile_sources()
        again = [replace(case, name=f"{case.name} again") for case in (REFERENCE, MODELS["PidRbf"])]
        cases = [(standing(case), "constant") for case in [*moving, *again]]
        cases += [(case, "changing") for case in [*moving, *again, *in_c]]
        rounds, measured = max(self.some(500) // PROCESSES, 1), [case for case, _ in cases]
        parts = [self.host.measure("cycle", CYCLES, rounds, measured) for _ in range(PROCESSES)]
        return {
            f"cycle/{case.name} {inputs}": [time for line in lines for time in line["ns"]]
            for (case, inputs), *lines in zip(cases, *parts, strict=True)
        }

    def baseline(self) -> Case:
        """Export the network with the vectors that every processor of the platform has."""
        out = self.folder / "baseline"
        command = [PROGRAM, "export", "--package", "fmu-controller", "--no-default-features"]
        run([*command, "--out", out])
        (out / "PidRbf.fmu").rename(self.folder / f"{BASELINE.model}.fmu")
        return BASELINE

    def compile_sources(self) -> list[Case]:
        """Compile the C sources of FMUs with each compiler; return the cases with the results."""
        compilers = {name: path for name, path in COMPILERS.items() if shutil.which(path)}
        cases, level = IN_C, "-O2"
        if self.quick:
            compilers, cases, level = {"cc": COMPILERS["cc"]}, cases[:2], "-O0"
        jobs = [
            (case, compiled(case, compiler), path, level)
            for case, (compiler, path) in product(cases, compilers.items())
        ]
        with ThreadPool(CORES) as pool:
            pool.starmap(self.host.compile, jobs)
        return [to for _, to, *_ in jobs]

    def threads(self) -> Costs:
        """Measure a cycle in several threads, to show what the cores of the machine can bring."""
        # The start of the threads must not matter
        lines = self.host.measure("threads", self.some(500_000), self.some(50), [MODELS["PidRbf"]])
        return {f"threads/{line['fmu']}/{line['threads']}": line["ns"] for line in lines}

    # --- one FMU, by each kind of call

    def calls(self) -> Costs:
        """Measure setting an input, a step and getting an output."""

        def in_c(case: Case, **env: str) -> float:
            return median(self.host.measure("cycle", CYCLES, self.some(50), [case], **env)[0]["ns"])

        subjects = {"call/C": lambda: in_c(CALL)}
        if not self.quick:
            subjects["call/Rust"] = self.in_rust
        if environment := self.pythonfmu():
            case = replace(CALL, model="PythonPid")
            subjects["call/PythonFMU"] = lambda: in_c(case, **environment)
        subjects |= {
            name: partial(self.from_python, name, self.some(n)) for name, n in CALLS.items()
        }
        return self.alternate(subjects, self.few_rounds)

    def pythonfmu(self) -> dict[str, str]:
        """Build `Pid` with PythonFMU; return the environment that it needs, nothing without it."""
        parts = map(sysconfig.get_config_var, ("LIBDIR", "INSTSONAME"))
        library = Path(*(part or "" for part in parts))  # which PythonFMU's binary needs
        if not library.is_file() or ".so" not in library.name or not find_spec("pythonfmu"):
            return {}
        script = BENCH / "python_pid.py"
        run([sys.executable, "-m", "pythonfmu", "build", "-f", script, "-d", self.folder])
        paths = {"PYTHONHOME": sys.base_prefix, "PYTHONPATH": sysconfig.get_path("purelib")}
        return {"LD_PRELOAD": str(library)} | paths

    def in_rust(self) -> float:
        """Measure by the crate fmu-host."""
        given, variables = self.host.unpack(CALL.model)
        words = dict(word.split("=", 1) for word in given)
        references = [variables[name].valueReference for name in ("y", "u")]
        fmu = [CALL.name, words["fmi"], words["binary"], words["guid"], *references, 0.001]
        [times] = in_host(50, CYCLES, fmu).values()
        return median(times)

    def samples(self) -> Costs:
        """Measure controllers in Rust, without FMUs."""
        times = in_host(self.some(500), CYCLES, [])
        return {f"sample/{name}": found for name, found in times.items()}

    # --- the masters

    def alternate(
        self, subjects: Mapping[str, Callable[[], float]], rounds: int, tries: int = 1
    ) -> Costs:
        """Measure all subjects in turn, in each round; the best of some tries counts."""
        times: Costs = {name: [] for name in subjects}
        for _ in range(rounds):
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
            "pair/FMPy": lambda: fmpy_script.pair(FMUS, few),
            "run/all": lambda: duration(self.simulation(COUPLED, 20_000)),
        }
        if not self.quick:  # its program has no wasmtime
            subjects["pair/wasmtime"] = lambda: self.natively(components, few) / few
        return self.alternate(subjects, self.rounds, tries=3)

    def systems(self) -> Costs:
        """Measure a step of one FMU in a small and in a large system."""
        sizes = (2, 100 if self.quick else 1000)
        files = {size: write_system(self.folder / f"{size}.toml", size // 2) for size in sizes}
        steps = self.some(2_000_000)
        return self.alternate(
            {
                f"system/{size}": lambda s=size, f=file: self.natively(f, steps // s) / steps
                for size, file in files.items()
            },
            self.rounds,
        )

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
        return self.alternate({"sweep/C": bare} | counts, self.rounds)

    # --- from Python

    def python(self, script: str, *words: object) -> Any:
        """Return what a script prints, as JSON; it has the module with the fast native part."""
        paths = [self.packages, ROOT / "python", MATRIX]
        command = [sys.executable, BENCH / script, *words]
        return json.loads(run(command, {"PYTHONPATH": os.pathsep.join(map(str, paths))}))

    def from_python(self, what: str, count: int, folder: Path = FMUS) -> float:
        """Return what bench/from_python.py measures."""
        return self.python("from_python.py", what, folder, count)

    def masters(self) -> Costs:
        """Measure a step of a loop of three FMUs by each master that can be called here."""
        subjects = {}
        for name, steps in MASTERS.items():
            load = [sys.executable, "-c", f"import {OTHERS.get(name, 'sys')}"]
            # Ecos needs a library of the system.
            if subprocess.run(load, capture_output=True, check=False).returncode == 0:
                subjects[name] = partial(self.from_python, name, self.some(steps))
        return self.alternate(subjects, self.few_rounds)

    def module(self) -> Costs:
        """Measure the first result, and a sweep in 1 and 2 processes."""
        file = self.sweep_file(8.0)  # long runs, as starting Python is not to count
        subjects = {
            name: partial(self.from_python, name, 1) for name in ("first/ours", "first/FMPy")
        }
        subjects |= {f"module/{n}": partial(self.from_python, "sweep", n, file) for n in (1, 2)}
        return self.alternate(subjects, self.few_rounds)

    def environments(self) -> Costs:
        """Measure environments for reinforcement learning."""
        few = (1, 0.001, SIZES[0]) if self.quick else (self.few_rounds, 0.2, *SIZES)
        found = self.python("environments.py", FMUS, *few)
        return {f"environment/{name}": times for name, times in found.items()}

    def plots(self) -> Costs:
        """Measure the time, the memory and the page of a plot of many rows; and without a plot."""
        page, costs = self.folder / "plot.html", {}
        command = [*self.simulation(FMUS / "Source.fmu", self.some(ROWS)), "--set", "signal=sine"]
        for name, words in (("run", command), ("plot", [*command, "--plot", page])):
            begin = time.perf_counter_ns()
            process = subprocess.Popen(list(map(str, words)), stdout=subprocess.DEVNULL)
            _, status, used = os.wait4(process.pid, 0)
            if status:
                raise SystemExit(f"{words} failed")
            costs[f"{name}/time"] = [float(time.perf_counter_ns() - begin)]
            costs[f"{name}/memory"] = [1024.0 * used.ru_maxrss]
        return costs | {"plot/size": [float(page.stat().st_size)]}

    # --- instructions

    def counts(self) -> dict[str, float]:
        """Count the instructions of a cycle or step with valgrind.

        They are the difference of runs of two lengths, and do not depend on the load of the
        machine. Return nothing if there is no valgrind.
        """
        if not shutil.which("valgrind"):
            return {}
        pid, rbf, ipid = (MODELS[name] for name in ("Pid", "PidRbf", "IpidRbf"))
        plant = MODELS["Pendulum, linear"]
        cases = {case.name: case for case in (REFERENCE, pid, rbf, ipid, plant)}
        cases |= {case.name: case for case in map(in_fmi3, (pid, rbf))}
        cases["PidRbf, constant inputs"] = standing(rbf)
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
        return {
            name: (counted(command(more)) - counted(command(fewer))) / (more - fewer)
            for name, command in commands.items()
        }


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


def duration(command: Sequence[object]) -> float:
    """Return the time (ns) of a command from start to end."""
    begin = time.perf_counter_ns()
    run(command)
    return time.perf_counter_ns() - begin


def reported(text: str) -> float:
    """Return the time (ns) that a simulation took, from what it prints."""
    return 1e6 * float(text.split(" s in ")[1].split(" ms")[0])


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


def counted(command: Sequence[str | Path]) -> int:
    """Return the instructions of a command, of its processes the one that executes the most."""
    tool = ["valgrind", "--tool=callgrind", "--callgrind-out-file=/dev/null"]
    command = [*tool, "--trace-children=yes", *map(str, command)]
    text = subprocess.run(command, capture_output=True, text=True, check=True).stderr
    return max(map(int, re.findall(r"Collected : (\d+)", text)))
