"""The native master makes the calls of `fmpy.simulate_fmu`: tolerance, stop time, start values."""

import json
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest

from native import compiled, pack, run, simulate

STEP = 1 / 1024
"""A communication step without rounding errors [s], since FMPy takes differences of times."""

XML = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="Adaptive" guid="{adaptive}">
  <CoSimulation modelIdentifier="Adaptive" canHandleVariableCommunicationStepSize="true"/>
  <DefaultExperiment stopTime="1" tolerance="1e-3"/>
  <ModelVariables>
    <ScalarVariable name="x" valueReference="0" initial="exact"><Real start="1"/></ScalarVariable>
    <ScalarVariable name="u" valueReference="1" causality="input"><Real start="0"/></ScalarVariable>
    <ScalarVariable name="y" valueReference="2" causality="output"><Real/></ScalarVariable>
    <ScalarVariable name="tolerance" valueReference="3" causality="output"><Real/></ScalarVariable>
    <ScalarVariable name="stop" valueReference="4" causality="output"><Real/></ScalarVariable>
  </ModelVariables>
  <ModelStructure>
    <Outputs><Unknown index="3"/><Unknown index="4"/><Unknown index="5"/></Outputs>
    <InitialUnknowns><Unknown index="3"/><Unknown index="4"/><Unknown index="5"/></InitialUnknowns>
  </ModelStructure>
</fmiModelDescription>
"""


def build(folder: Path, *definitions: str, xml: str = XML, name: str = "Adaptive") -> Path:
    """Write an FMU of tests/c/adaptive.c."""
    binary = compiled(folder, *definitions, source="adaptive.c")
    return pack(folder / f"{name}.fmu", xml, binary)


def system(folder: Path, fmu: Path, start: dict[str, Any], head: str = "", own: str = "") -> Path:
    """Write a system of one component `a`."""
    values = ", ".join(f"{name} = {json.dumps(value)}" for name, value in start.items())
    file = folder / "system.toml"
    file.write_text(
        f"stop = 1.0\nstep = {STEP}\n{head}\n[[component]]\n"
        f'name = "a"\nfmu = "{fmu}"\nstart = {{ {values} }}\n{own}\n'
    )
    return file


def assert_fmpys_bits(columns: dict[str, np.ndarray], fmu: Path, **options: Any) -> None:
    """Compare with `fmpy.simulate_fmu`, which records the same communication points."""
    outputs = [name.removeprefix("a.") for name in columns if name != "time"]
    expected = fmpy.simulate_fmu(
        fmu, stop_time=1.0, output_interval=STEP, output=outputs, **options
    )
    for name in ("time", *outputs):
        column = columns["time" if name == "time" else f"a.{name}"]
        np.testing.assert_array_equal(column, expected[name])


@pytest.mark.parametrize(
    ("head", "own", "options", "tolerance"),
    [
        ("", "", [], 1e-3),
        ("tolerance = 1e-5", "", [], 1e-5),
        ("tolerance = 1e-5", "tolerance = 1e-7", [], 1e-7),
        ("tolerance = 1e-5", "tolerance = 1e-7", ["--tolerance", "1e-6"], 1e-6),
    ],
    ids=["default experiment", "system", "component", "option"],
)
def test_the_tolerance_gives_the_bits_of_fmpy(head, own, options, tolerance, tmp_path):
    start = {"x": 2.0, "u": 0.5}
    fmu = build(tmp_path)
    columns = simulate(system(tmp_path, fmu, start, head, own), tmp_path, *options)
    assert set(columns["a.tolerance"]) == {tolerance}
    assert set(columns["a.stop"]) == {1.0}
    assert columns["a.y"][0] == 2.0
    given = None if not head else tolerance
    assert_fmpys_bits(columns, fmu, start_values=start, relative_tolerance=given)


def test_without_any_tolerance_none_is_given(tmp_path):
    fmu = build(tmp_path, xml=XML.replace(' tolerance="1e-3"', ""))
    columns = simulate(system(tmp_path, fmu, {}), tmp_path)
    assert set(columns["a.tolerance"]) == {0.0}
    assert_fmpys_bits(columns, fmu)


def test_a_sampled_component_has_a_step_from_the_stop_time(tmp_path):
    fmu = build(tmp_path)
    columns = simulate(system(tmp_path, fmu, {}, own="sampled = true"), tmp_path)
    assert set(columns["a.stop"]) == {1 + STEP}


@pytest.mark.parametrize("value", ["0.0", "-1e-6", "inf", "nan"])
def test_a_wrong_tolerance_is_refused(value, tmp_path):
    file = system(tmp_path, build(tmp_path), {}, own=f"tolerance = {value}")
    error = run("simulate", file).stderr
    assert "tolerance of a = " in error
    assert "expected a positive number" in error


def test_pendulum_gives_the_bits_of_fmpy(fmus, tmp_path):
    fmu = fmus / "Pendulum.fmu"
    start = {"theta0": 0.1, "u": 0.2, "model": "nonlinear"}
    columns = simulate(system(tmp_path, fmu, start), tmp_path)
    assert np.ptp(columns["a.theta"]) > 0.1
    variables = fmpy.read_model_description(fmu).modelVariables
    (model,) = (v for v in variables if v.name == "model")
    start["model"] = next(
        item.value for item in model.declaredType.items if item.name == "nonlinear"
    )
    assert_fmpys_bits(columns, fmu, start_values=start)


def test_a_failed_end_of_the_initialization_is_named(tmp_path):
    file = system(tmp_path, build(tmp_path, "FAIL_INITIALIZATION"), {})
    error = run("simulate", file).stderr
    assert "end of the initialization at t = 0.0 s: fmi2ExitInitializationMode" in error


def test_a_model_identifier_may_be_any_file_name(tmp_path):
    xml = XML.replace('Identifier="Adaptive"', 'Identifier="my-model 2"')
    fmu = build(tmp_path, xml=xml, name="my-model 2")
    assert "modelIdentifier" in run("validate", "--no-run", fmu).stdout
    assert simulate(system(tmp_path, fmu, {}), tmp_path)["a.y"][-1] < 1.0


def test_a_model_identifier_stays_in_its_folder(tmp_path):
    for identifier in ("../linux64/Adaptive", "x/Adaptive", "/etc/passwd"):
        fmu = build(
            tmp_path, xml=XML.replace('Identifier="Adaptive"', f'Identifier="{identifier}"')
        )
        assert "no binary for this machine" in run("simulate", system(tmp_path, fmu, {})).stderr


def test_invalid_variables_are_left_out(tmp_path):
    invalid = '<ModelVariables><ScalarVariable name="v" valueReference="9" causality="odd"/>'
    xml = XML.replace("<ModelVariables>", invalid)
    for index in (5, 4, 3):
        xml = xml.replace(f'index="{index}"', f'index="{index + 1}"')
    fmu = build(tmp_path, xml=xml)
    assert simulate(system(tmp_path, fmu, {}), tmp_path)["a.y"][-1] < 1.0
    assert "5 variables, without 1 that are invalid" in run("info", fmu).stdout
