"""C hosts run the FMUs natively, under valgrind without findings, and on other platforms.

Tests under valgrind and on other platforms only run with `pytest -m valgrind` or
`pytest -m elsewhere`.
"""

import functools
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import prod
from pathlib import Path, PureWindowsPath
from typing import NamedTuple

import fmpy
import numpy as np
import pytest
from fmpy.model_description import ModelVariable

import needs
from native import SECONDS, SOURCES, new_package, shell
from pendulum_fmus import loop
from pendulum_fmus.loop import TS
from pendulum_fmus.master import Component, FmpySystem, simulate
from pendulum_fmus.project import FMUS, PROGRAM, ROOT

CROSS = FMUS.parent / "cross"
"""Folder to which `make cross` writes FMUs for other platforms."""

# Results are compared bit by bit, so the compiler must not fuse multiplications and additions.
OPTIONS = """-std=c99 -D_POSIX_C_SOURCE=200809L -Wall -Wextra -Werror -g
-ffp-contract=off""".split()
OPTIONS.append(f"-I{Path(fmpy.__file__).parent / 'c-code'}")


# --- machines -------------------------------------------------------------------------------------


class Fmu(NamedTuple):
    """An unpacked FMU binary and its model description."""

    binary: Path
    guid: str
    variables: dict[str, ModelVariable]


@dataclass(frozen=True)
class Machine:
    """A machine: how to compile programs for it and run them on it."""

    name: str
    tools: tuple[needs.Tool, ...] = ()
    compiler: tuple[str, ...] = ("cc",)
    emulator: tuple[str, ...] = ()
    libraries: tuple[str, ...] = ("-ldl", "-lm")
    fmus: Path = FMUS
    platforms: tuple[str, str] = ("linux64", "x86_64-linux")
    """Folders of its binaries in these FMUs, in FMI 2.0 and 3.0."""
    target: str | None = None
    """Its name for `cargo fmu export`; by default this machine."""

    def compile(self, name: str, folder: Path) -> Path:
        """Compile one of the hosts, such as `loop`, or `host3` for FMI 3.0."""
        program, version = folder / f"{name}.exe", name[-1:]
        options = [*OPTIONS, f"-DFMI={version}"] if version.isdigit() else OPTIONS
        source = SOURCES / f"{name.rstrip('23')}.c"
        command = [*self.compiler, *options, "-o", program, source, *self.libraries]
        subprocess.run(command, check=True)
        return program

    def run(self, program: Path, *arguments: str) -> str:
        """Run a program that must succeed without warnings; return its output."""
        done = _call(*self.emulator, program, *arguments)
        assert (done.returncode, done.stderr) == (0, ""), done.stderr
        return done.stdout

    def unpack(self, model: str, folder: Path, fmus: Path | None = None) -> Fmu:
        """Unpack an FMU, by default an exported one, with its binary for the machine."""
        file = (fmus or self.fmus) / f"{model}.fmu"
        if not file.exists():
            pytest.fail(f"{file} is missing: `make cross` exports it", pytrace=False)
        description = fmpy.read_model_description(file)
        platform = self.platforms[description.fmiVersion == "3.0"]
        extension = "dll" if "win" in platform else "so"
        name = f"binaries/{platform}/{description.coSimulation.modelIdentifier}.{extension}"
        with zipfile.ZipFile(file) as package:
            binary = Path(package.extract(name, folder / model))
        return Fmu(binary, description.guid, {v.name: v for v in description.modelVariables})

    def path(self, file: Path) -> str:
        """Return the path of a file as its programs see it: Wine has all files on drive Z."""
        return str(PureWindowsPath(f"Z:{file}")) if self is WINDOWS else str(file)


def _call(*command: str | Path) -> subprocess.CompletedProcess[str]:
    options = {"stdin": subprocess.DEVNULL, "capture_output": True, "text": True}
    return subprocess.run(command, timeout=SECONDS, **options)


NATIVE = Machine("native")

VALGRIND = Machine(
    "valgrind",
    (needs.VALGRIND,),
    emulator=(
        "valgrind", "--quiet", "--error-exitcode=9", "--leak-check=full",
        "--errors-for-leak-kinds=definite,indirect",
    ),
)  # fmt: skip

# Wine 8.0 lacks bcryptprimitives.dll, which seeds Rust's HashMap; the FMUs do not use one.
WINDOWS = Machine(
    "windows",
    (needs.MINGW, needs.WINE),
    compiler=("x86_64-w64-mingw32-gcc",),
    emulator=("wine",),
    libraries=(),
    fmus=CROSS,
    platforms=("win64", "x86_64-windows"),
    target="x86_64-pc-windows-gnu",
)

ARM = Machine(
    "arm",
    (needs.QEMU,),
    compiler=(sys.executable, "-m", "ziglang", "cc", "-target", "aarch64-linux-gnu.2.17"),
    emulator=("qemu-aarch64", "-L", "/usr/aarch64-linux-gnu"),
    fmus=CROSS / "aarch64",
    platforms=("linux64", "aarch64-linux"),
    target="aarch64-unknown-linux-gnu.2.17",
)

MACHINES = [
    NATIVE,
    pytest.param(VALGRIND, marks=pytest.mark.valgrind),
    pytest.param(WINDOWS, marks=pytest.mark.elsewhere),
    pytest.param(ARM, marks=pytest.mark.elsewhere),
]


@contextmanager
def wine(folder: Path) -> Iterator[None]:
    """Create a separate Wine prefix, and stop its processes at the end."""
    with pytest.MonkeyPatch.context() as environment:
        for name, value in {
            "WINEPREFIX": str(folder / "wine"),
            "WINEARCH": "win64",
            "WINEDEBUG": "-all",
            "WINEDLLOVERRIDES": "mscoree,mshtml,winemenubuilder.exe=",  # nothing to install
            "DISPLAY": "",
        }.items():
            environment.setenv(name, value)
        try:
            _call("wine", "wineboot", "--init").check_returncode()
            yield
        finally:
            _call("wineserver", "--kill")  # fails if it has already exited


@pytest.fixture(scope="module", params=MACHINES, ids=lambda machine: machine.name)
def machine(request, fmus, tmp_path_factory) -> Iterator[Machine]:
    """Return each of the machines, started."""
    machine = request.param
    for tool in machine.tools:
        tool.require()
    if machine is not WINDOWS:
        yield machine
        return
    with wine(tmp_path_factory.mktemp("wine")):
        yield machine


@pytest.fixture(scope="module")
def program(machine, tmp_path_factory) -> Callable[[str], Path]:
    """Return a function that compiles a host for the machine once."""
    folder = tmp_path_factory.mktemp("hosts")
    return functools.cache(lambda name: machine.compile(name, folder))


# --- correct and incorrect use of every FMU -----------------------------------------------------

SCENARIOS = [
    "life_cycle", "values", "fmu_state", "damaged_bytes", "bad_arguments", "two_instances", "reset",
    "trouble",
]  # fmt: skip

RUNS = [
    # One model per binary, since the models of a binary share this code.
    ("Pendulum", "host2", ["exchange"]),
    ("PidRbf", "host2", ["exchange"]),
    ("Source", "host2", []),
    ("Pendulum_fmi3", "host3", ["events", "exchange", "derivatives"]),
    ("PidRbf_fmi3", "host3", ["events", "exchange", "sizes"]),
]

LETTERS = {
    "Real": "r", "Float64": "r", "Boolean": "b", "UInt64": "n", "String": "t", "Binary": "y",
}  # fmt: skip


def letter(variable: ModelVariable) -> str:
    """Return the letter of a type."""
    return LETTERS.get(variable.type, "i")


def described(model: Fmu, variable: ModelVariable) -> str:
    """Return a variable in the format of the hosts; times are unchanged."""
    states = [v.derivative for v in model.variables.values() if v.derivative is not None]
    kind = letter(variable)
    values = {
        "r": lambda start: float(start.split()[0]) * 1.25 or 0.125,
        "b": lambda start: int(start == "false"),
        "i": lambda start: int(start) % len(variable.declaredType.items) + 1,
    }
    other = values.get(kind, lambda _: 7)
    if variable in states:
        kind = "x"
    elif variable.derivative is not None:
        kind = "d"
    elif states and variable.causality == "input":
        kind = "u"
    size = prod(int(d.start or d.variable.start) for d in variable.dimensions)
    text = f"{kind}{variable.valueReference}" + (f"*{size}" if size > 1 else "")
    if variable.start is None or variable.causality == "independent" or variable.name == "ts":
        return text
    return f"{text}={other(variable.start)!r}"


def run_scenarios(machine: Machine, host: Path, fmu: Fmu, scenarios: list[str]) -> None:
    """Run a host, which must print nothing."""
    variables = [described(fmu, variable) for variable in fmu.variables.values()]
    for scenario in scenarios:
        arguments = [machine.path(fmu.binary), fmu.guid, scenario, *variables]
        assert machine.run(host, *arguments) == "", scenario


@pytest.mark.parametrize(("model", "host", "more"), RUNS, ids=[model for model, *_ in RUNS])
def test_a_host_runs_every_scenario(machine, program, model, host, more, tmp_path):
    run_scenarios(machine, program(host), machine.unpack(model, tmp_path), SCENARIOS + more)


def test_a_panic_only_affects_its_instance(machine, program, tmp_path):
    package = new_package("panicking", tmp_path)
    shutil.copy(ROOT / "tests" / "data" / "panicking.rs", package / "src" / "lib.rs")
    option = f"--target {machine.target}" if machine.target else ""
    export = f"{PROGRAM} export Panicking {option} --out {tmp_path}"
    shell(f"{export} 2>&1 | grep 'data (a Binary), copy (a Binary); expected --fmi 3.0'", package)
    shell(f"{export} --fmi 2.0,3.0 --omit-unsupported", package)
    for file, host, step in (
        ("Panicking", "host2", "fmi2DoStep"),
        ("Panicking_fmi3", "host3", "fmi3DoStep"),
    ):
        fmu = machine.unpack(file, tmp_path, tmp_path)
        u, y = (fmu.variables[name].valueReference for name in ("u", "y"))
        arguments = [machine.path(fmu.binary), fmu.guid, "panic", f"r{u}=-1", f"r{y}"]
        line, *refused = machine.run(program(host), *arguments).splitlines()
        assert line.startswith(f"[logStatusFatal] {step}: ")
        assert line.endswith("panicked; the instance can only be freed: u is -1.0")
        assert all(" is not allowed in the state " in line for line in refused)
    run_scenarios(machine, program("host3"), fmu, ["values", "fmu_state", "damaged_bytes"])


# --- closed loops -------------------------------------------------------------------------------

LOOPS = {
    "Pid": {"signal": "step", "disturbance": 1.0, "plant_model": "transfer_function"},
    "PidRbf": {"signal": "square"},
    "IpidRbf": {
        "signal": "sine",
        "target": "supervisor",
        "plant_model": "nonlinear",
        "overrides": (("source.amplitude", 0.1),),
    },
}
"""Loops that cover every FMU and every plant model."""

STEPS = 6000
"""Long enough for the disturbance and the jump of the square wave at 5 s."""


@functools.cache
def simulated(controller: str, fmus: Path) -> tuple[list[tuple[str, list[str]]], dict]:
    """Simulate a closed loop with FMPy; return the arguments of each model, and the results."""
    with loop.Loop(controller, **LOOPS[controller]).system(fmus) as system:
        results = simulate(system, start=TS, step=TS, steps=STEPS)
        del results["time"]
        components = [(c.path.stem, words(system, c)) for c in system.components.values()]
    return components, results


def words(system: FmpySystem, component: Component) -> list[str]:
    """Return kind, parameters, links and outputs of a simulated component."""
    names = list(system.components)
    fmu = component.fmu
    getters = {"r": fmu.getReal, "i": fmu.getInteger, "b": fmu.getBoolean}
    parameters = [
        f"{letter(v)}{v.valueReference}={float(value)!r}"
        for v in component.variables.values() if v.causality == "parameter"
        for value in getters[letter(v)]([v.valueReference])
    ]  # fmt: skip
    links = []
    for pair in system.connections:
        (source, output), (fed, input_) = map(system.locate, pair)
        if fed is component:
            of, to = source.variable(output), fed.variable(input_)
            links.append(f"r{to.valueReference}<{names.index(source.name)}.{of.valueReference}")
    outputs = [f"r{component.variable(name).valueReference}" for name in component.outputs()]
    kind = "sampled" if component.sampled else "continuous"
    return [kind, *parameters, *links, *outputs]


@pytest.mark.parametrize("controller", LOOPS)
def test_a_host_gives_the_bits_of_the_python_master(machine, program, controller, fmus, tmp_path):
    components, results = simulated(controller, fmus)
    file = tmp_path / "results"
    arguments = [machine.path(file), str(STEPS)]
    for number, (model, description) in enumerate(components):
        fmu = machine.unpack(model, tmp_path / str(number))
        arguments += [machine.path(fmu.binary), fmu.guid, *description, "."]
    assert machine.run(program("loop"), *arguments) == ""
    rows = np.fromfile(file).reshape(STEPS, len(results))
    for column, (name, expected) in zip(rows.T, results.items(), strict=True):
        assert column.tobytes() == expected.tobytes(), name
