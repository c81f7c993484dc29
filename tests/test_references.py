"""Parameter sets, experiments and reference results of FMUs: the layered standard FMI-LS-REF."""

import json
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fmu_master import FmuError, System, simulate
from native import printed, refusal, run

FOLDER = "extra/org.fmi-standard.fmi-ls-ref/"
SSV = """<?xml version="1.0" encoding="UTF-8"?>
<ssv:ParameterSet xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues"
    xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon" version="1.0"
    name="leaning" description="It leans">
  <ssv:Parameters>
    <ssv:Parameter name="theta0"><ssv:Real value="{theta0}" unit="{unit}"/></ssv:Parameter>
    <ssv:Parameter name="{name}"><ssv:Real value="0.25"/></ssv:Parameter>
  </ssv:Parameters>
  <ssv:Units>
    <ssc:Unit name="degree"><ssc:BaseUnit rad="1" factor="0.017453292519943295"/></ssc:Unit>
  </ssv:Units>
</ssv:ParameterSet>
"""
MANIFEST = """<?xml version="1.0" encoding="UTF-8"?>
<fmiReferences xmlns:fmi-ls="http://fmi-standard.org/fmi-ls-manifest"
    fmi-ls:fmi-ls-name="org.fmi-standard.fmi-ls-ref" fmi-ls:fmi-ls-version="1.0.0-alpha.1"
    fmi-ls:fmi-ls-description=
      "Layered Standard providing information on related files included in an FMU.">
  <Related type="application/x-ssp-parameter-set" source="leaning.ssv" role="parameter"
      description="A set"/>
  <Related type="application/x-ma-hs-experiments" source="all.exp" role="experiment/smoke-test"/>
</fmiReferences>
"""
EXPERIMENTS = """<?xml version="1.0" encoding="UTF-8"?>
<Experiments name="Smoke tests">
  <Experiment name="push" description="A push" startTime="0.5" stopTime="1.0" stepSize="0.01"
      tolerance="{tolerance}">
    <Parameters source="leaning.ssv"/>
    <Stimuli source="in.csv"/>
    <References source="out.csv"/>
  </Experiment>
  <Experiment name="newer"><TransientSimulation stopTime="0.1" stepSize="0.05"/></Experiment>
  <Experiment name="still"><SteadyState/></Experiment>
</Experiments>
"""
STIMULI = "time,u\n0.5,0\n0.7,2\n0.7,1\n1,1\n"
"""The force: a ramp, and a jump down."""

OPTIONS = {"start_time": 0.5, "stop_time": 1.0, "step_size": 0.01}
TABLE = {"time": [0.5, 0.7, 0.7, 1.0], "u": [0.0, 2.0, 1.0, 1.0]}


def set_of(theta0: float = 0.1, unit: str = "rad", name: str = "x0") -> str:
    """Return the text of a parameter set."""
    return SSV.format(theta0=theta0, unit=unit, name=name)


def with_files(fmu: Path, file: Path, files: dict[str, str | None]) -> Path:
    """Copy an FMU, and add files to the folder of the standard."""
    shutil.copy(fmu, file)
    with zipfile.ZipFile(file, "a", zipfile.ZIP_DEFLATED) as archive:
        for name, text in files.items():
            if text is not None:
                archive.writestr(FOLDER + name, text)
    return file


def files(**changes: str | None) -> dict[str, str | None]:
    """Return the files of an FMU, of which some are others."""
    names = {"manifest": "fmi-ls-manifest.xml", "set": "leaning.ssv", "exp": "all.exp"}
    texts = {
        "manifest": MANIFEST,
        "set": set_of(),
        "exp": EXPERIMENTS.format(tolerance="1e-6"),
        "in": STIMULI,
        "out": "time,theta\n0.5,0.1\n",
    }
    return {names.get(name, f"{name}.csv"): text for name, text in (texts | changes).items()}


@pytest.fixture(params=["Pendulum.fmu", "Pendulum_fmi3.fmu"])
def plant(fmus: Path, request: pytest.FixtureRequest) -> Path:
    """Return an FMU of each version, without references."""
    return fmus / request.param


def test_an_experiment_has_the_bits_of_its_options(plant: Path, tmp_path: Path) -> None:
    fmu = with_files(plant, tmp_path / "a.fmu", files())
    start = {"theta0": 0.1, "x0": 0.25}
    expected = simulate(plant, start_values=start, input=TABLE, tolerance=1e-6, **OPTIONS)
    result = simulate(fmu, experiment="push")
    assert result["time"][0] == 0.5
    for name in expected:
        np.testing.assert_array_equal(result[name], expected[name])
    csv = tmp_path / "out.csv"
    printed("simulate", fmu, "--experiment", "push", "--output", "theta", "--csv", csv)
    assert csv.read_text() == "time [s],theta [rad]\n" + "".join(
        f"{time!r},{theta!r}\n"
        for time, theta in zip(expected["time"].tolist(), expected["theta"].tolist(), strict=True)
    )
    # Other options replace what the experiment has.
    other = simulate(fmu, experiment="push", stop_time=0.6, start_values={"theta0": 0.2})
    assert (other["time"][-1], other["theta"][0], other["x"][0]) == (0.6, 0.2, 0.25)
    without = simulate(fmu, experiment="push", input={"time": [0.5], "u": [0.0]})
    expected = simulate(plant, start_values=start, tolerance=1e-6, **OPTIONS)
    np.testing.assert_array_equal(without["theta"], expected["theta"])
    assert simulate(fmu, experiment="newer")["time"].tolist() == [0, 0.05, 0.1]


def test_a_parameter_set_has_the_values_of_start_values_in_any_unit(
    plant: Path, tmp_path: Path
) -> None:
    degrees = set_of(theta0=18, unit="degree", name="unknown")
    fmu = with_files(plant, tmp_path / "a.fmu", files(set=degrees))
    own = tmp_path / "own.ssv"
    own.write_text(set_of())
    turned = {"theta0": 18 * 0.017453292519943295}
    for name, start in (("leaning", turned), (own, {"theta0": 0.1, "x0": 0.25})):
        expected = simulate(plant, start_values=start, stop_time=0.1)
        result = simulate(fmu, parameters=name, stop_time=0.1)
        np.testing.assert_array_equal(result["theta"], expected["theta"])
        assert result["x"][0] == start.get("x0", 0)
    printed_ = printed("simulate", fmu, "--parameters", "leaning", "--stop", "0.1")
    assert "note: a has no variables unknown, which its parameter set has" in printed_
    # In a system, a component has a parameter set, and its start values replace values of the set.
    text = (
        'stop = 0.1\nstep = 0.01\n[[component]]\nname = "p"\nfmu = "a.fmu"\n'
        'parameters = "{}"\nstart = {{ x0 = 3 }}\n'
    )
    for name, value in (("leaning", turned["theta0"]), ("own.ssv", 0.1)):
        file = tmp_path / "system.toml"
        file.write_text(text.format(name))
        result = System(file).simulate()
        assert (result["p.theta"][0], result["p.x"][0]) == (value, 3)
        component = {"fmu": fmu, "parameters": own if name == "own.ssv" else name}
        result = System(components={"p": component}, stop=0.1, step=0.01).simulate()
        assert result["p.theta"][0] == value


def test_what_cannot_be_used_is_named(fmus: Path, tmp_path: Path) -> None:
    plant = fmus / "Pendulum.fmu"
    fmu = with_files(plant, tmp_path / "a.fmu", files())
    for options, reason in (
        ({"parameters": "x"}, 'there is no parameter set "x", expected one of leaning'),
        ({"experiment": "x"}, 'there is no experiment "x", expected one of push, newer, still'),
        ({"experiment": "still"}, "it is of the kind SteadyState, expected a simulation over time"),
        ({"parameters": 1}, "parameters = 1, expected the name of a parameter set"),
    ):
        with pytest.raises(FmuError, match=reason):
            simulate(fmu, **options)
    with pytest.raises(FmuError, match="it has no parameter sets and experiments, as it has no"):
        simulate(plant, parameters="leaning")
    message = refusal(tmp_path, "simulate", fmu, "--parameters", "leaning.ss")
    assert message.endswith('there is no parameter set "leaning.ss", expected one of leaning')
    loop = System(components={"p": fmu}, stop=0.1, step=0.01)
    for options in ({"parameters": "leaning"}, {"experiment": "push"}):
        with pytest.raises(FmuError, match="belongs to one FMU, but this is a system"):
            loop.simulate(**options)
    hdf5 = EXPERIMENTS.replace("in.csv", 'in.csv" type="application/hdf5')
    fmu = with_files(plant, tmp_path / "b.fmu", files(exp=hdf5.format(tolerance=1)))
    with pytest.raises(FmuError, match=r'in.csv is of the type "application/hdf5", expected text/'):
        simulate(fmu, experiment="push")
    wrong = with_files(plant, tmp_path / "c.fmu", files(**{"in": "time,v\n0,1\n"}))
    with pytest.raises(FmuError, match=r"in.csv in .*c.fmu: v is an output, expected an input"):
        simulate(wrong, experiment="push")


def test_info_lists_parameter_sets_experiments_and_files(fmus: Path, tmp_path: Path) -> None:
    fmu = with_files(fmus / "Pendulum.fmu", tmp_path / "a.fmu", files())
    shown = printed("info", fmu)
    for line in (
        "  leaning: It leans, 2 parameters",
        "  push: A push, start 0.5 s, stop 1.0 s, step 0.01 s, tolerance 1e-6, parameters",
        "  still: SteadyState",
        f"  {FOLDER}leaning.ssv: parameter, A set",
    ):
        assert line in shown
    found = json.loads(printed("info", "--json", fmu))["references"]
    assert [set_["parameters"] for set_ in found["parameterSets"]] == [["theta0", "x0"]]
    assert found["experiments"][0]["stimuli"] == FOLDER + "in.csv"
    assert [file["role"] for file in found["relatedFiles"]] == [
        "parameter",
        "experiment/smoke-test",
    ]
    assert "references" not in json.loads(printed("info", "--json", fmus / "Pendulum.fmu"))


@pytest.fixture(scope="module")
def validated(fmus: Path) -> Callable[[Path], dict[str, str]]:
    """Return a function that validates an FMU with references: its rules and first findings."""

    def validate(fmu: Path, *options: str) -> dict[str, str]:
        options = ("--format=json", *options)
        report = json.loads(run("validate", fmu, *options).stdout)["files"][0]
        return {rule["id"]: rule["findings"][0]["text"] for rule in report["rules"]}

    return validate


def results(fmu: Path, error: float) -> str:
    """Return the results of the experiment, of which the last one has an error."""
    result = simulate(fmu, experiment="push")
    rows = zip(result["time"].tolist(), result["theta"].tolist(), strict=True)
    lines = [f"{time!r},{theta!r}" for time, theta in rows]
    largest = float(np.abs(result["theta"]).max())
    lines[-1] = f"1.0,{float(result['theta'][-1]) + error * largest!r}"
    return "\n".join(["time,theta", *lines]) + "\n"


def test_the_validator_compares_reference_results_and_checks_the_files(
    fmus: Path, tmp_path: Path, validated: Callable[..., dict[str, str]]
) -> None:
    plant = fmus / "Pendulum.fmu"
    quick = ("--quick",)
    first = with_files(plant, tmp_path / "first.fmu", files())
    for error, tolerance, is_found in ((0.9e-3, "1e-3", False), (1.1e-3, "1e-3", True)):
        own = files(out=results(first, error), exp=EXPERIMENTS.format(tolerance=tolerance))
        fmu = with_files(plant, tmp_path / f"{is_found}.fmu", own)
        found = validated(fmu, *quick).get("experiment-results", "")
        assert ('experiment "push": theta differs at t = 1 s' in found) == is_found, found
    no_run = ("--no-run",)
    for changes, rule, words in (
        ({"manifest": "<fmiReferences"}, "references-readable", ""),
        ({"manifest": MANIFEST.replace("fmiRef", "fmuRef")}, "references-form", "fmuReferences"),
        ({"manifest": MANIFEST.replace('role="parameter"', 'role="x"')}, "references-form", '"x"'),
        ({"set": None}, "references-exist", f"the FMU has no {FOLDER}leaning.ssv"),
        ({"out": None}, "references-exist", f"the FMU has no {FOLDER}out.csv"),
        ({"set": set_of(name="y0")}, "references-variables", 'the parameter is "y0"'),
    ):
        fmu = with_files(plant, tmp_path / "c.fmu", files(**changes))
        found = validated(fmu, *no_run)
        assert words in found[rule], found
    assert validated(first, *no_run) == {}
    unknown = with_files(plant, tmp_path / "d.fmu", files(out="time,thta\n0.5,0.1\n1,0\n"))
    found = validated(unknown, *quick)["experiment-results"]
    assert "cannot be performed" in found
    assert "has no variable thta; did you mean theta" in found


def test_a_result_without_experiment_is_that_of_the_default_experiment(
    fmus: Path, tmp_path: Path, validated: Callable[..., dict[str, str]]
) -> None:
    # As the Reference FMUs have it, without the description that the schema requires.
    manifest = (
        '<fmiReferences xmlns:fmi-ls="http://fmi-standard.org/fmi-ls-manifest" '
        'fmi-ls:fmi-ls-name="org.fmi-standard.fmi-ls-ref" fmi-ls:fmi-ls-version="1.0.0-alpha.1">'
        '<Related type="text/csv" source="out.csv" role="result"/></fmiReferences>'
    )
    plant = fmus / "Source.fmu"
    csv = tmp_path / "out.csv"
    printed("simulate", plant, "--csv", csv)
    right = csv.read_text()
    *rows, last = right.splitlines()
    wrong = "\n".join([*rows, ",".join([last.split(",")[0], *(["9"] * last.count(","))])]) + "\n"
    for text, is_found in ((right, False), (wrong, True)):
        own = {"fmi-ls-manifest.xml": manifest, "out.csv": text}
        fmu = with_files(plant, tmp_path / f"{is_found}.fmu", own)
        found = validated(fmu, "--quick")
        assert ("default-results" in found) == is_found
        assert "fmi-ls-description" in found["references-form"]
