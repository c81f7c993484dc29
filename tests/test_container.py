"""The loops in a third-party master: FMPy's compiled container, which steps in parallel.

The container is an FMU itself. Its variables are those of its FMUs, named "component.variable".
"""

import copy
from collections.abc import Mapping, Sequence
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.container_fmu.cli import create_container_fmu
from fmpy.container_fmu.config import Component, Configuration, Connection
from fmpy.model_description import CoSimulation, ModelDescription, ModelVariable, Unknown

from pendulum_fmus.loop import TS, Loop
from pendulum_fmus.master import simulate

STEPS = 6000


class Inside:
    """The FMUs in a container, {component: model}."""

    def __init__(self, fmus: Path, models: Mapping[str, str]):
        self.components = {
            name: Component(name, path, fmpy.read_model_description(path))
            for name, path in ((name, fmus / f"{model}.fmu") for name, model in models.items())
        }

    def locate(self, name: str) -> tuple[Component, ModelVariable]:
        """Look up "component.variable"."""
        component, _, variable = name.partition(".")
        found = self.components[component]
        variables = {v.name: v for v in found.modelDescription.modelVariables}
        return found, variables[variable]

    def connection(self, output: str, input_: str) -> Connection:
        """Connect an output to an input."""
        (source, start), (fed, end) = self.locate(output), self.locate(input_)
        start = copy.copy(start)
        start.type = "Float64"  # the container uses the types of FMI 3.0 here
        return Connection(source, [start], fed, [end])

    def parameter(self, name: str, start: str) -> ModelVariable:
        """Return a container parameter that sets a parameter of an inner FMU."""
        kind = self.locate(name)[1].type
        return ModelVariable(
            name=name,
            valueReference=0,
            type="Integer" if kind == "Enumeration" else kind,
            causality="parameter",
            variability="fixed",
            initial="exact",
            start=start,
        )


def variable(name: str, causality: str, initial: str | None = None) -> ModelVariable:
    """Return a continuous variable of the container."""
    return ModelVariable(
        name=name,
        valueReference=0,
        type="Real",
        causality=causality,
        variability="continuous",
        initial=initial,
    )


def container(
    inside: Inside,
    connections: Sequence[tuple[str, str]],
    outputs: Sequence[str],
    parameters: Mapping[str, str],
    folder: Path,
) -> Path:
    """Write a container FMU that steps its FMUs by 1 ms; return its path."""
    shown = [variable(name, "output", "calculated") for name in outputs]
    mapped = shown + [inside.parameter(name, start) for name, start in parameters.items()]
    description = ModelDescription(
        fmiVersion="2.0",
        modelName="loop",
        coSimulation=CoSimulation(modelIdentifier="container_fmu", fixedInternalStepSize=TS),
        # The container's first variable is the time
        modelVariables=[variable("time", "independent"), *mapped],
        outputs=[Unknown(variable=v) for v in shown],
        initialUnknowns=[Unknown(variable=v) for v in shown],
    )
    description.guid = "loop"
    configuration = Configuration(
        parallelDoStep=False,
        modelDescription=description,
        components=list(inside.components.values()),
        connections=[inside.connection(*pair) for pair in connections],
        variableMappings={v: [inside.locate(v.name)] for v in mapped},
    )
    (folder / "unzipped").mkdir()
    create_container_fmu(configuration, folder / "unzipped", folder / "loop.fmu")
    return folder / "loop.fmu"


@pytest.mark.parametrize(
    ("controller", "target"),
    [("Pid", "own"), ("PidRbf", "own"), ("IpidRbf", "own"), ("IpidRbf", "supervisor")],
)
def test_a_compiled_master_gives_the_same_bits(fmus, tmp_path, controller, target):
    # Values of enumeration items: the square wave and the network's target
    parameters = {
        "source.signal": "3", "source.frequency": "0.1", "source.disturbance.amplitude": "1.0",
    }  # fmt: skip
    if target == "supervisor":
        parameters["controller.rbf.target"] = "2"
    outputs = ["source.r", "source.d", "plant.theta"]

    loop = Loop(controller, "square", 1.0, target, previous_sample_terms=False)
    with loop.system(fmus) as system:
        models = {name: c.description.modelName for name, c in system.components.items()}
        ours = simulate(system, TS, TS, STEPS, order="parallel", record=outputs)
        connections = system.connections

    path = container(Inside(fmus, models), connections, outputs, parameters, tmp_path)
    theirs = fmpy.simulate_fmu(
        path, start_time=TS, stop_time=STEPS * TS, step_size=TS, output_interval=TS
    )
    for name in outputs:
        np.testing.assert_array_equal(theirs[name], ours[name])
