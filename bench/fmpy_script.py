"""Scripts that call FMPy's own API for each value and step, as FMPy's documentation does."""

import shutil
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path

import fmpy
from fmpy.fmi2 import FMU2Slave

STEP = 0.001

Slave = tuple[FMU2Slave, dict[str, list[int]]]
"""An instance, and the value references of its variables, in a list each, by name."""


@contextmanager
def initialized(file: Path, start_values: Mapping[str, float] | None = None) -> Iterator[Slave]:
    """Instantiate and initialize an FMU."""
    description, folder = fmpy.read_model_description(file), fmpy.extract(file)
    references = {v.name: [v.valueReference] for v in description.modelVariables}
    identifier = description.coSimulation.modelIdentifier
    words = {"guid": description.guid, "unzipDirectory": folder, "modelIdentifier": identifier}
    slave = FMU2Slave(**words, instanceName=file.stem)
    slave.instantiate()
    for name, value in (start_values or {}).items():
        slave.setReal(references[name], [value])
    slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    yield slave, references
    slave.terminate()
    slave.freeInstance()
    shutil.rmtree(folder)


def call(folder: Path, steps: int) -> float:
    """Return the time [ns] to set an input of `Pid`, step, and get an output, once."""
    with initialized(folder / "Pid.fmu") as (pid, references):
        y, u = references["y"], references["u"]
        begin = time.perf_counter_ns()
        for k in range(steps):
            pid.setReal(y, [0.001 * (k % 2)])
            pid.doStep(currentCommunicationPoint=k * STEP, communicationStepSize=STEP)
            pid.getReal(u)
        return (time.perf_counter_ns() - begin) / steps


def pair(folder: Path, steps: int) -> float:
    """Return the time [ns] of a step of the coupled pair."""
    with (
        initialized(folder / "PidRbf.fmu", {"r": 0.01}) as (controller, own),
        initialized(folder / "Pendulum.fmu") as (plant, others),
    ):
        errors = []
        begin = time.perf_counter_ns()
        for k in range(steps):
            controller.setReal(own["y"], plant.getReal(others["theta"]))
            controller.doStep(k * STEP, STEP)
            plant.setReal(others["u"], controller.getReal(own["u"]))
            plant.doStep(k * STEP, STEP)
            errors.append(controller.getReal(own["e"])[0])
        return (time.perf_counter_ns() - begin) / steps


def loop(
    fmus: Mapping[str, Path], connections: Iterable[tuple[str, str, str, str]], steps: int
) -> float:
    """Return the time [ns] of a step of coupled FMUs in parallel order, which records the angle."""
    with ExitStack() as stack:
        slaves = {name: stack.enter_context(initialized(file)) for name, file in fmus.items()}
        plant, theta = slaves["plant"][0], slaves["plant"][1]["theta"]
        links = [
            (slaves[a][0], slaves[a][1][output], slaves[b][0], slaves[b][1][input_])
            for a, output, b, input_ in connections
        ]
        angles = []
        begin = time.perf_counter_ns()
        for k in range(steps):
            values = [source.getReal(output) for source, output, _, _ in links]
            for (_, _, target, input_), value in zip(links, values, strict=True):
                target.setReal(input_, value)
            for slave, _ in slaves.values():
                slave.doStep(k * STEP, STEP)
            angles.append(plant.getReal(theta)[0])
        return (time.perf_counter_ns() - begin) / steps
