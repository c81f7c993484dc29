"""C hosts run the FMUs natively, under valgrind without findings, and on other platforms.

Tests under valgrind and on other platforms only run with `pytest -m valgrind` or
`pytest -m elsewhere`.
"""

import functools
from collections.abc import Callable, Iterator
from math import prod
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from fmpy.model_description import ModelVariable

import pages
from machines import MACHINES, Fmu, Machine
from pendulum_fmus import loop
from pendulum_fmus.loop import TS
from pendulum_fmus.master import Component, System, simulate

SCENARIOS = [
    "life_cycle", "values", "fmu_state", "damaged_bytes", "bad_arguments", "two_instances", "reset",
    "trouble",
]  # fmt: skip


@pytest.fixture(scope="module", params=MACHINES, ids=lambda machine: machine.name)
def machine(request, fmus, tmp_path_factory) -> Iterator[Machine]:
    """Return each of the machines, started."""
    machine = request.param
    with machine.started(tmp_path_factory.mktemp(machine.name)):
        yield machine


@pytest.fixture(scope="module")
def program(machine, tmp_path_factory) -> Callable[[str], Path]:
    """Return a function that compiles a host for the machine once."""
    folder = tmp_path_factory.mktemp("hosts")
    return functools.cache(lambda name: machine.compile(name, folder))


# --- correct and incorrect use of every FMU -----------------------------------------------------


def described(model: Fmu, variable: ModelVariable) -> str:
    """Return a variable in the format of the hosts; times are unchanged."""
    kind = _letter(variable)
    size = prod(int(d.start or d.variable.start) for d in variable.dimensions)
    text = f"{_kind(model, variable)}{variable.valueReference}" + (f"*{size}" if size > 1 else "")
    if variable.start is None or variable.causality == "independent" or variable.name == "ts":
        return text
    if kind == "r":
        other = float(variable.start.split()[0]) * 1.25 or 0.125
    elif kind == "b":
        other = int(variable.start == "false")
    elif kind == "i":
        other = int(variable.start) % len(variable.declaredType.items) + 1
    else:
        other = 7
    return f"{text}={other!r}"


def _letter(variable: ModelVariable) -> str:
    return {
        "Real": "r", "Float64": "r", "Boolean": "b", "UInt64": "n", "String": "t", "Binary": "y",
    }.get(variable.type, "i")  # fmt: skip


def _kind(fmu: Fmu, variable: ModelVariable) -> str:
    """Return the letter of a variable: of its type, or of its part in equations."""
    states = [v.derivative for v in fmu.variables.values() if v.derivative is not None]
    if variable in states:
        return "x"
    if variable.derivative is not None:
        return "d"
    return "u" if states and variable.causality == "input" else _letter(variable)


def run_scenarios(machine: Machine, host: Path, fmu: Fmu, scenarios: list[str]) -> None:
    """Run a host, which must print nothing."""
    variables = [described(fmu, variable) for variable in fmu.variables.values()]
    for scenario in scenarios:
        arguments = [machine.path(fmu.binary), fmu.guid, scenario, *variables]
        assert machine.run(host, *arguments) == "", scenario


@pytest.mark.parametrize("model", ["Pendulum", "PidRbf", "Source"])
def test_a_host_runs_every_scenario(machine, program, model):
    """One model per binary, since the models of a binary share this code."""
    more = [] if model == "Source" else ["exchange"]
    run_scenarios(machine, program("host"), machine.unpack(model), SCENARIOS + more)


@pytest.mark.parametrize(
    ("model", "more"),
    [("Pendulum", ["derivatives"]), ("PidRbf", ["sizes"])],
    ids=["Pendulum", "PidRbf"],
)
def test_a_host_of_fmi_3_runs_every_scenario(machine, program, model, more):
    fmu = machine.unpack(f"{model}_fmi3")
    run_scenarios(machine, program("host3"), fmu, [*SCENARIOS, "events", "exchange", *more])


def test_a_panic_only_affects_its_instance(machine, program, tmp_path):
    pages.export_panicking(tmp_path, machine.target)
    for file, host, step in (
        ("Panicking", "host", "fmi2DoStep"),
        ("Panicking_fmi3", "host3", "fmi3DoStep"),
    ):
        fmu = machine.unpack(file, tmp_path)
        u, y = (fmu.variables[name].valueReference for name in ("u", "y"))
        arguments = [machine.path(fmu.binary), fmu.guid, "panic", f"r{u}=-1", f"r{y}"]
        (line,) = machine.run(program(host), *arguments).splitlines()
        assert line.startswith(f"[logStatusFatal] {step}: ")
        assert line.endswith("panicked and is dead: u is -1.0")
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

STEPS = 20_000


class Loop(NamedTuple):
    """A closed loop: its components in the format of the host, and its results with FMPy."""

    components: list[tuple[str, list[str]]]
    """Model and arguments of each component."""
    results: dict[str, np.ndarray]


@functools.cache
def simulated(controller: str, fmus: Path) -> Loop:
    """Simulate a closed loop with FMPy."""
    with loop.Loop(controller, **LOOPS[controller]).system(fmus) as system:
        results = simulate(system, start=TS, step=TS, steps=STEPS)
        del results["time"]
        components = [(c.path.stem, words(system, c)) for c in system.components.values()]
    return Loop(components, results)


def words(system: System, component: Component) -> list[str]:
    """Return kind, parameters, links and outputs of a simulated component."""
    names = list(system.components)
    slave = component.slave
    getters = {"r": slave.getReal, "i": slave.getInteger, "b": slave.getBoolean}
    parameters = [
        f"{_letter(v)}{v.valueReference}={float(value)!r}"
        for v in component.variables.values() if v.causality == "parameter"
        for value in getters[_letter(v)]([v.valueReference])
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
    loop = simulated(controller, fmus)
    file = tmp_path / "results"
    arguments = [machine.path(file), str(STEPS)]
    for model, description in loop.components:
        fmu = machine.unpack(model)
        arguments += [machine.path(fmu.binary), fmu.guid, *description, "."]
    assert machine.run(program("loop"), *arguments) == ""
    rows = np.fromfile(file).reshape(STEPS, len(loop.results))
    for column, (name, expected) in zip(rows.T, loop.results.items(), strict=True):
        assert column.tobytes() == expected.tobytes(), name
