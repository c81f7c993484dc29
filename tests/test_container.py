"""The loops in a third-party master: FMPy's compiled container, which steps in parallel.

The container is an FMU itself. It has the variables of its FMUs, named "component.variable".
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


def container(
    files: Mapping[str, Path],
    connections: Sequence[tuple[str, str]],
    outputs: Sequence[str],
    parameters: Mapping[str, str],
    folder: Path,
) -> Path:
    """Write a container FMU that steps FMUs, {component: file}, by 1 ms; return its path."""
    descriptions = {name: fmpy.read_model_description(file) for name, file in files.items()}
    components = {name: Component(name, files[name], descriptions[name]) for name in files}

    def locate(name: str) -> tuple[Component, ModelVariable]:
        component, _, variable = name.partition(".")
        variables = descriptions[component].modelVariables
        return components[component], next(v for v in variables if v.name == variable)

    def connection(output: str, input_: str) -> Connection:
        (source, start), (fed, end) = locate(output), locate(input_)
        start = copy.copy(start)
        start.type = "Float64"  # the container uses the types of FMI 3.0 here
        return Connection(source, [start], fed, [end])

    def variable(name: str, kind: str, causality: str, variability: str, **more) -> ModelVariable:
        return ModelVariable(name, 0, kind, causality=causality, variability=variability, **more)

    shown = [
        variable(name, "Real", "output", "continuous", initial="calculated") for name in outputs
    ]
    mapped = list(shown)
    for name, start in parameters.items():
        kind = locate(name)[1].type
        kind = "Integer" if kind == "Enumeration" else kind
        mapped.append(variable(name, kind, "parameter", "fixed", initial="exact", start=start))
    description = ModelDescription(
        fmiVersion="2.0",
        modelName="loop",
        coSimulation=CoSimulation(modelIdentifier="container_fmu", fixedInternalStepSize=TS),
        # The container's first variable is the time
        modelVariables=[variable("time", "Real", "independent", "continuous"), *mapped],
        outputs=[Unknown(variable=v) for v in shown],
        initialUnknowns=[Unknown(variable=v) for v in shown],
    )
    description.guid = "loop"
    configuration = Configuration(
        parallelDoStep=False,
        modelDescription=description,
        components=list(components.values()),
        connections=[connection(*pair) for pair in connections],
        variableMappings={v: [locate(v.name)] for v in mapped},
    )
    (folder / "unzipped").mkdir()
    create_container_fmu(configuration, folder / "unzipped", folder / "loop.fmu")
    return folder / "loop.fmu"


@pytest.mark.parametrize(("controller", "target"), [("PidRbf", "own"), ("IpidRbf", "supervisor")])
def test_a_compiled_master_gives_the_same_bits(fmus, tmp_path, controller, target):
    # Values of enumeration items: the square wave and the network's target
    parameters = {"source.signal": "3", "source.frequency": "0.1"}
    parameters["source.disturbance.amplitude"] = "1.0"
    if target == "supervisor":
        parameters["controller.rbf.target"] = "2"
    outputs = ["source.r", "source.d", "plant.theta"]
    loop = Loop(controller, "square", 1.0, target, previous_sample_terms=False)
    with loop.system(fmus) as system:
        ours = simulate(system, TS, TS, STEPS, order="parallel", record=outputs)
    files = {name: fmus / file for name, file in loop.files().items()}
    path = container(files, loop.connections(), outputs, parameters, tmp_path)
    times = {"start_time": TS, "stop_time": STEPS * TS, "step_size": TS, "output_interval": TS}
    theirs = fmpy.simulate_fmu(path, **times)
    for name in outputs:
        np.testing.assert_array_equal(theirs[name], ours[name])
