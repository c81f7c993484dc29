"""Directional derivatives: all listed pairs, in every state that allows them."""

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from zipfile import ZipFile

import fmpy
import pytest
from fmpy.fmi2 import FMU2Model, FMU2Slave
from fmpy.fmi3 import FMU3Model, FMU3Slave
from fmpy.model_description import ModelVariable, Unknown

REALS = {"Real", "Float64"}
CLASSES = {
    ("ME", True): FMU2Model,
    ("CS", True): FMU2Slave,
    ("ME", False): FMU3Model,
    ("CS", False): FMU3Slave,
}


def pairs(listed: list[Unknown]) -> Iterator[tuple[ModelVariable, ModelVariable]]:
    """Return the pairs of Reals; our FMUs with derivatives list all dependencies."""
    for unknown in listed:
        if unknown.variable.type in REALS:
            yield from ((unknown.variable, by) for by in unknown.dependencies if by.type in REALS)


class Instance:
    """An instance of either version and kind, in initialization mode."""

    def __init__(self, file: Path, folder: Path, kind: str, **options: bool) -> None:
        self.description = fmpy.read_model_description(file)
        self.is_2 = self.description.fmiVersion == "2.0"
        self.fmu = CLASSES[kind, self.is_2](
            guid=self.description.guid,
            unzipDirectory=fmpy.extract(file, folder),
            modelIdentifier=file.stem.removesuffix("_fmi3"),
        )
        self.fmu.instantiate(**options)
        if self.is_2:
            self.fmu.setupExperiment(startTime=0.5)
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(startTime=0.5)

    def get(self, reference: int) -> float:
        """Get a Real."""
        get = self.fmu.getReal if self.is_2 else self.fmu.getFloat64
        return get([reference])[0]

    def quotient(self, of: int, by: int) -> float:
        """Return the difference quotient of a variable with respect to one that can be set."""
        put = self.fmu.setReal if self.is_2 else self.fmu.setFloat64
        value, changed = self.get(by), []
        for change in (-1e-5, 1e-5, 0.0):
            put([by], [value + change])
            changed.append(self.get(of))
        return (changed[1] - changed[0]) / 2e-5

    def check(self, listed: list[Unknown], can_be_set: Callable[[ModelVariable], bool]) -> None:
        """Get the derivatives of all pairs; compare with quotients if the knowns can be set."""
        found = list(pairs(listed))
        assert found
        for of, by in found:
            numbers = [of.valueReference], [by.valueReference]
            (derivative,) = self.fmu.getDirectionalDerivative(*numbers, [1.0])
            if by.causality == "independent":
                assert derivative == 0, "the equations are autonomous"
            elif can_be_set(by):
                quotient = self.quotient(of.valueReference, by.valueReference)
                assert derivative == pytest.approx(quotient, rel=1e-4, abs=1e-4)


KINDS = {
    "ME": ("ME", {}, "2.0 3.0"),
    "CS": ("CS", {}, "2.0 3.0"),
    "CS with events": ("CS", {"eventModeUsed": True}, "3.0"),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_every_listed_pair_has_a_derivative_in_every_state(
    fmus: Path, equations: Path, version: str, kind: str, tmp_path: Path
) -> None:
    name, options, versions = KINDS[kind]
    files = [*fmus.glob("*.fmu"), *equations.glob("*.fmu")]
    provided = set()
    for file in files:
        with ZipFile(file) as archive:
            xml = archive.read("modelDescription.xml").decode()
        is_provided = re.search(r'providesDirectionalDerivatives?="true"', xml)  # not read by FMPy
        if version not in versions or f'fmiVersion="{version}"' not in xml or not is_provided:
            continue
        provided.add(file.stem.removesuffix("_fmi3"))
        it = Instance(file, tmp_path / file.stem, name, **options)
        description = it.description
        states = [unknown.variable.derivative.name for unknown in description.derivatives]
        listed = [*description.outputs, *description.derivatives, *description.eventIndicators]

        def is_start(v: ModelVariable) -> bool:
            return v.causality in ("parameter", "input")

        def is_known(v: ModelVariable, states: list[str] = states) -> bool:
            return v.causality == "input" or v.name in states

        def is_never(_v: ModelVariable) -> bool:
            return False

        it.check(description.initialUnknowns, is_start)
        it.fmu.exitInitializationMode()
        it.check(listed, is_known if name == "ME" else is_never)
        if name == "ME":
            it.fmu.enterContinuousTimeMode()
            it.check(listed, is_known)
        else:
            if options:
                it.fmu.enterStepMode()
            it.fmu.doStep(0.5, 0.125)
            it.check(listed, is_never)
        it.fmu.terminate()
        it.check(listed, is_never)
        it.fmu.freeInstance()
    assert provided == ({"Pendulum", "VanDerPol"} if version in versions else set())
