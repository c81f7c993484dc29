"""C hosts run the FMUs natively, under valgrind without findings, and on other platforms.

Tests under valgrind and on other platforms only run with `pytest -m valgrind` or
`pytest -m elsewhere`.
"""

import functools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from fmpy.model_description import ModelVariable

import pages
from machines import MACHINES, Machine
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


def described(variable: ModelVariable) -> str:
    """Return a variable in the format of the host; times are unchanged."""
    text = f"{_letter(variable)}{variable.valueReference}"
    if variable.start is None or variable.name == "ts":
        return text
    if variable.type == "Real":
        other = float(variable.start) * 1.25 or 0.125
    elif variable.type == "Boolean":
        other = int(variable.start == "false")
    else:
        other = int(variable.start) % len(variable.declaredType.items) + 1
    return f"{text}={other!r}"


def _letter(variable: ModelVariable) -> str:
    return {"Real": "r", "Boolean": "b"}.get(variable.type, "i")


@pytest.mark.parametrize("model", ["Pendulum", "PidRbf", "Source"])
def test_a_host_runs_every_scenario(machine, program, model):
    """One model per binary, since the models of a binary share this code."""
    fmu = machine.unpack(model)
    variables = [described(variable) for variable in fmu.variables.values()]
    for scenario in SCENARIOS:
        arguments = [machine.path(fmu.binary), fmu.guid, scenario, *variables]
        assert machine.run(program("host"), *arguments) == "", scenario


def test_a_panic_only_affects_its_instance(machine, program, tmp_path):
    pages.export_panicking(tmp_path, machine.target)
    fmu = machine.unpack("Panicking", tmp_path)
    u, y = (fmu.variables[name].valueReference for name in ("u", "y"))
    arguments = [machine.path(fmu.binary), fmu.guid, "panic", f"r{u}=-1", f"r{y}"]
    (line,) = machine.run(program("host"), *arguments).splitlines()
    assert line.startswith("[logStatusFatal] fmi2DoStep: ")
    assert line.endswith("panicked and is dead: u is -1.0")


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
    links = [
        f"r{fed}<{names.index(outputs.component.name)}.{output}"
        for outputs, inputs in system.links[component.name]
        for output, fed in zip(outputs.references, inputs.references, strict=True)
    ]
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
