"""Closed loops of the paper for the host `tests/c/loop.c`."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from fmpy.model_description import ModelVariable

from machines import Fmu, Machine
from pendulum_fmus.loop import TS, Loop
from pendulum_fmus.master import Component, FmpySystem

MODELS = ["Pid", "PidRbf", "IpidRbf", "Pendulum", "Source"]

LETTERS = {
    "Real": "r", "Float64": "r", "Boolean": "b", "UInt64": "n", "String": "t", "Binary": "y",
}  # fmt: skip

Components = list[tuple[str, list[str]]]
"""The FMU of each component of a loop, and the words that describe the component to the host."""


def stems(version: str) -> list[str]:
    """Return the names of the FMUs of the models for FMI 2 or 3."""
    return [f"{model}_fmi3" if version == "3" else model for model in MODELS]


def letter(variable: ModelVariable) -> str:
    """Return the letter of a type."""
    return LETTERS.get(variable.type, "i")


def described_loop(loop: Loop, fmus: Path) -> Components:
    """Return the components of a loop."""
    with loop.system(fmus) as system:
        for component in system.components.values():
            component.initialize(TS)
        return [(c.path.stem, _words(system, c)) for c in system.components.values()]


def _words(system: FmpySystem, component: Component) -> list[str]:
    """Return kind, parameters, links and outputs of an initialized component."""
    names = list(system.components)

    def word(variable: ModelVariable) -> str:
        size = len(component.elements[variable.name])
        return f"{letter(variable)}{variable.valueReference}" + (f"*{size}" if size > 1 else "")

    parameters = [
        f"{word(v)}={','.join(repr(float(component.get(e))) for e in component.elements[v.name])}"
        for v in component.description.modelVariables if v.causality == "parameter"
    ]  # fmt: skip
    links = []
    for pair in system.connections:
        (source, output), (fed, input_) = map(system.locate, pair)
        if fed is component:
            of, to = source.variable(output), fed.variable(input_)
            links.append(f"r{to.valueReference}<{names.index(source.name)}.{of.valueReference}")
    outputs = dict.fromkeys(word(component.variable(name)) for name in component.outputs())
    kind = "sampled" if component.sampled else "continuous"
    return [kind, *parameters, *links, *outputs]


def run_loop(
    machine: Machine, program: Path, fmus: Sequence[Fmu], loop: Components, steps: int, file: Path
) -> bytes:
    """Run a loop, which must print nothing; return the doubles of all outputs, by rows."""
    by_name = dict(zip(MODELS, fmus, strict=True))
    arguments = [machine.path(file), str(steps)]
    for name, words in loop:
        fmu = by_name[name.removesuffix("_fmi3")]
        arguments += [fmu.library, fmu.guid, *words, "."]
    assert machine.run(program, *arguments) == ""
    return np.fromfile(file, f"{machine.byte_order}f8").astype("<f8").tobytes()
