"""C hosts run the FMUs natively, under valgrind without findings, and on other platforms.

The FMUs are binaries, or C sources that other compilers compile for other processors. Tests under
valgrind and of binaries for other platforms only run with `pytest -m valgrind` or
`pytest -m elsewhere`.
"""

import functools
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from math import prod
from pathlib import Path

import numpy as np
import pytest
from fmpy.model_description import ModelVariable

from loops import MODELS, Components, described_loop, letter, run_loop, stems
from machines import (
    ARM,
    IN_C,
    IN_C_ELSEWHERE,
    IN_C_OPTIONAL,
    IN_C_VALGRIND,
    NATIVE,
    VALGRIND,
    WINDOWS,
    Fmu,
    Machine,
    SourceMachine,
)
from native import new_package, shell
from pendulum_fmus import table1
from pendulum_fmus.loop import TS, Loop
from pendulum_fmus.master import simulate
from pendulum_fmus.project import PROGRAM, ROOT

MARKS = {
    NATIVE: [],
    VALGRIND: [pytest.mark.valgrind],
    WINDOWS: [pytest.mark.elsewhere],
    ARM: [pytest.mark.elsewhere],
    **{machine: [] for machine in IN_C},
    **{machine: [machine.tools[0].mark] for machine in IN_C_OPTIONAL},
    IN_C_VALGRIND: [pytest.mark.elsewhere],
    **{machine: [pytest.mark.elsewhere] for machine in IN_C_ELSEWHERE},
}
"""All machines, with the marks of their tests."""

C_SOURCES = [machine for machine in MARKS if isinstance(machine, SourceMachine)]

BINARIES = [machine for machine in MARKS if machine not in C_SOURCES]


def on(machines: Sequence[Machine], names: str, *rows: tuple) -> pytest.MarkDecorator:
    """Run a test on machines with each of the rows whose last field is a version that they test."""
    params = [
        pytest.param(machine, *row, marks=MARKS[machine], id=f"{machine.name}-{row[0]}")
        for machine in machines for row in rows if row[-1] in machine.versions
    ]  # fmt: skip
    return pytest.mark.parametrize(f"machine, {names}", params, indirect=["machine"])


Host = Callable[..., tuple[Path, list[Fmu]]]
"""Compiles a host, such as `loop2` for FMI 2.0, for some FMUs."""


@pytest.fixture(scope="module")
def machine(request, fmus, tmp_path_factory) -> Iterator[Machine]:
    """Return a machine, started."""
    with request.param.started(tmp_path_factory.mktemp("machine")):
        yield request.param


@pytest.fixture(scope="module")
def host(machine, request, tmp_path_factory) -> Host:
    """Return a function that compiles a host for FMUs, by default the exported ones, once."""
    if isinstance(machine, SourceMachine):
        request.getfixturevalue("sources")
    folder = tmp_path_factory.mktemp("hosts")

    def prepare(name: str, *models: str, fmus: Path | None = None) -> tuple[Path, list[Fmu]]:
        files = [(fmus or machine.fmus) / f"{model}.fmu" for model in models]
        return machine.host(name, files, folder)

    return prepare


# --- correct and incorrect use of every FMU -----------------------------------------------------

SCENARIOS = [
    "life_cycle", "values", "fmu_state", "damaged_bytes", "bad_arguments", "two_instances", "reset",
    "trouble",
]  # fmt: skip

RUNS = [
    # One model per binary, since the models of a binary share this code.
    ("Pendulum", ["exchange"], "2"),
    ("PidRbf", ["exchange"], "2"),
    ("Source", [], "2"),
    ("Pendulum_fmi3", ["events", "exchange", "derivatives"], "3"),
    ("PidRbf_fmi3", ["events", "exchange", "sizes"], "3"),
]


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


def run_scenarios(machine: Machine, program: Path, fmu: Fmu, scenarios: Sequence[str]) -> None:
    """Run a host, which must print nothing."""
    variables = [described(fmu, variable) for variable in fmu.variables.values()]
    for scenario in scenarios:
        assert machine.run(program, fmu.library, fmu.guid, scenario, *variables) == "", scenario


@on(MARKS, "model, more, version", *RUNS)
def test_a_host_runs_every_scenario(machine, host, model, more, version):
    program, (fmu,) = host(f"host{version}", model)
    # A step that takes too long is one that an emulator takes minutes for.
    left_out = {"trouble"} if machine in C_SOURCES and machine.emulator else set()
    run_scenarios(machine, program, fmu, [s for s in SCENARIOS + more if s not in left_out])


@on([*BINARIES, IN_C[1]], "model, version", ("Panicking", "2"), ("Panicking_fmi3", "3"))
def test_a_panic_only_affects_its_instance(machine, host, panicking, model, version):
    program, (fmu,) = host(f"host{version}", model, fmus=panicking(machine))
    u, y = (fmu.variables[name].valueReference for name in ("u", "y"))
    arguments = [fmu.library, fmu.guid, "panic", f"r{u}=-1", f"r{y}"]
    line, *refused = machine.run(program, *arguments).splitlines()
    where = f"fmi{version}DoStep: " + "src/lib.rs:" * (machine in C_SOURCES)
    assert line.startswith(f"[logStatusFatal] {where}")
    assert line.endswith("panicked; the instance can only be freed: u is -1.0")
    assert all(" is not allowed in the state " in line for line in refused)
    if version == "3":
        run_scenarios(machine, program, fmu, ["values", "fmu_state", "damaged_bytes"])


@pytest.fixture(scope="session")
def panicking(once) -> Callable[[Machine], Path]:
    """Return a function that exports a model that panics, and returns the folder of its FMUs."""

    def export(machine: Machine, folder: Path) -> None:
        package = new_package("panicking", folder)
        shutil.copy(ROOT / "tests" / "data" / "panicking.rs", package / "src" / "lib.rs")
        command = f"{PROGRAM} export Panicking {machine.export_options} --out {folder}"
        refusal = "data (a Binary), copy (a Binary); expected --fmi 3.0"
        shell(f"{command} 2>&1 | grep '{refusal}'", package)
        shell(f"{command} --fmi 2.0,3.0 --omit-unsupported", package)

    def exported(machine: Machine) -> Path:
        name = "".join(["panicking", *machine.export_options.split()])
        return once(name, functools.partial(export, machine))

    return exported


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
def simulated(controller: str, fmus: Path) -> tuple[Components, dict]:
    """Simulate a closed loop with FMPy; return it, and the results."""
    loop = Loop(controller, **LOOPS[controller])
    with loop.system(fmus) as system:
        results = simulate(system, start=TS, step=TS, steps=STEPS)
    del results["time"]
    return described_loop(loop, fmus), results


@on(BINARIES, "controller, version", *((controller, "2") for controller in LOOPS))
def test_a_host_gives_the_bits_of_the_python_master(
    machine, host, controller, version, fmus, tmp_path
):
    components, results = simulated(controller, fmus)
    data = run_loop(
        machine, *host(f"loop{version}", *MODELS), components, STEPS, tmp_path / "results"
    )
    rows = np.frombuffer(data).reshape(STEPS, len(results))
    for column, (name, expected) in zip(rows.T, results.items(), strict=True):
        assert column.tobytes() == expected.tobytes(), name


@functools.cache
def loops_of_the_binaries(version: str, fmus: Path, folder: Path) -> list[tuple]:
    """Run the loops of Table 1 and `LOOPS` with the binaries; return each, components, results."""
    files = [fmus / f"{name}.fmu" for name in stems(version)]
    program, binaries = NATIVE.host(f"loop{version}", files, folder)
    runs = []
    covering = [Loop(controller, steps=STEPS, **about) for controller, about in LOOPS.items()]
    for loop in [*sorted(table1.runs(), key=repr), *covering]:
        components = described_loop(replace(loop, fmi3=("all",) * (version == "3")), fmus)
        results = run_loop(NATIVE, program, binaries, components, loop.steps, folder / "results")
        runs.append((loop, components, results))
    return runs


@on(C_SOURCES, "version", ("2",), ("3",))
def test_c_sources_give_the_bits_of_the_binaries_in_all_loops(
    machine, host, version, fmus, tmp_path_factory, tmp_path
):
    folder = tmp_path_factory.getbasetemp() / f"binaries{version}"
    folder.mkdir(exist_ok=True)
    compiled = host(f"loop{version}", *stems(version))
    for loop, components, expected in loops_of_the_binaries(version, fmus, folder):
        # The last row of the table has all controllers; an emulator takes seconds for each loop.
        if machine.emulator and (loop.signal, loop.disturbance) != ("square", 1.0):
            continue
        found = run_loop(machine, *compiled, components, loop.steps, tmp_path / "results")
        assert found == expected, loop
