"""Hosts in C use the FMUs: here; under valgrind, which finds nothing; and on other platforms.

Runs under valgrind and on other platforms are left out unless `pytest -m valgrind` or
`pytest -m elsewhere` asks for them.
"""

import functools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import pages
from machines import MACHINES, Machine
from pages import ROOT
from pendulum_fmus import loop
from pendulum_fmus.loop import TS
from pendulum_fmus.master import Component, System, simulate
from slave import Fmu, Variable, each_model, unpack

SCENARIOS = [
    "life_cycle", "values", "fmu_state", "damaged_bytes", "bad_arguments", "two_instances", "reset",
    "trouble",
]  # fmt: skip

each_scenario = pytest.mark.parametrize("scenario", SCENARIOS)


@pytest.fixture(scope="module", params=MACHINES, ids=lambda machine: machine.name)
def machine(request, fmus, tmp_path_factory) -> Iterator[Machine]:
    """Return each of the machines, started."""
    machine = request.param
    with machine.started(tmp_path_factory.mktemp(machine.name)):
        yield machine


@pytest.fixture(scope="module")
def program(machine, tmp_path_factory) -> Callable[[str], Path]:
    """Return a function that compiles a host for the machine, once."""
    folder = tmp_path_factory.mktemp("hosts")
    return functools.cache(lambda name: machine.compile(name, folder))


# --- every FMU, used well and badly -------------------------------------------------------------


def described(variable: Variable) -> str:
    """Return a variable as the host takes it; times stay as they are."""
    text = f"{variable.kind[0].lower()}{variable.reference}"
    if variable.settable(running=False) and variable.name != "ts":
        return f"{text}={variable.other_value()!r}"
    return text


@each_model
@each_scenario
def test_a_host_is_served(machine, program, model, scenario):
    fmu = machine.unpack(model)
    variables = [described(variable) for variable in fmu.variables.values()]
    arguments = [machine.path(fmu.binary), fmu.guid.decode(), scenario, *variables]
    assert machine.run(program("host"), *arguments) == ""


# --- a model that panics ------------------------------------------------------------------------

PANICKING = ROOT / "tests" / "data" / "panicking.rs"


@pytest.fixture(scope="module")
def panicking(machine, tmp_path_factory) -> Fmu:
    """Export the model that panics for the machine, in a copy of the sources."""
    copy = pages.project()
    (copy / "fmu-controller" / "src" / PANICKING.name).write_text(PANICKING.read_text())
    pages.export_models(copy, "mod panicking;\nfmu_export::export!(panicking::Panicking);")
    fmus = tmp_path_factory.mktemp("panicking")
    target = f"--target {machine.target}" if machine.target else ""
    pages.run(f"cargo fmu export Panicking {target} --out {fmus}", copy)
    return machine.unpack("Panicking", fmus)


def test_a_panic_ends_its_instance_alone(machine, program, panicking):
    told = machine.run(
        program("host"), machine.path(panicking.binary), panicking.guid.decode(), "panic",
        f"r{panicking.variables['u'].reference}=-1", f"r{panicking.variables['y'].reference}",
    )  # fmt: skip
    (line,) = told.splitlines()
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
"""Loops in which every FMU and every model of the plant takes part."""

STEPS = 20_000


class Loop(NamedTuple):
    """A closed loop: its components as the host takes them, and its results by FMPy."""

    components: list[tuple[str, list[str]]]
    """Model and words of each."""
    results: dict[str, np.ndarray]


@functools.cache
def simulated(controller: str, fmus: Path) -> Loop:
    """Simulate a closed loop by FMPy."""
    with loop.Loop(controller, **LOOPS[controller]).system(fmus) as system:
        results = simulate(system, start=TS, step=TS, steps=STEPS)
        del results["time"]
        components = [(c.path.stem, words(system, c)) for c in system.components.values()]
    return Loop(components, results)


def words(system: System, component: Component) -> list[str]:
    """Return kind, parameters, links and outputs of a component that was simulated."""
    names = list(system.components)
    fmu = unpack(component.path.parent, component.path.stem)
    parameters = [
        f"{v.kind[0].lower()}{v.reference}={float(value)!r}"
        for v in fmu.variables.values() if v.causality == "parameter"
        for value in getattr(component.slave, f"get{v.kind}")([v.reference])
    ]  # fmt: skip
    links = [
        f"r{fed}<{names.index(outputs.component.name)}.{output}"
        for outputs, inputs in system.links[component.name]
        for output, fed in zip(outputs.references, inputs.references, strict=True)
    ]
    outputs = [f"r{fmu.variables[name].reference}" for name in component.outputs()]
    kind = "sampled" if component.sampled else "continuous"
    return [kind, *parameters, *links, *outputs]


@pytest.mark.parametrize("controller", LOOPS)
def test_a_host_gives_the_bits_of_the_python_master(machine, program, controller, fmus, tmp_path):
    loop = simulated(controller, fmus)
    file = tmp_path / "results"
    arguments = [machine.path(file), str(STEPS)]
    for model, description in loop.components:
        fmu = machine.unpack(model)
        arguments += [machine.path(fmu.binary), fmu.guid.decode(), *description, "."]
    assert machine.run(program("loop"), *arguments) == ""
    rows = np.fromfile(file).reshape(STEPS, len(loop.results))
    for column, (name, expected) in zip(rows.T, loop.results.items(), strict=True):
        assert column.tobytes() == expected.tobytes(), name
