"""FMUs of FMI 3.0: the bits of those of FMI 2.0, in any pairing, and their descriptions."""

import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu

import reference
from pendulum_fmus import table1
from pendulum_fmus.loop import TS, Loop, start, workers
from pendulum_fmus.master import Component, MasterError, System, simulate
from pendulum_fmus.project import ROOT

MODELS = ["Pid", "PidRbf", "IpidRbf", "Pendulum", "Source"]


def bits(loop: Loop, fmus: Path, steps: int = 500, **options) -> dict[str, np.ndarray]:
    """Return all outputs of a loop."""
    with loop.system(fmus) as system:
        return simulate(system, TS, TS, steps, **options)


def assert_same_bits(columns: dict, expected: dict) -> None:
    """Compare names and bits of columns."""
    assert list(columns) == list(expected)
    for name, column in expected.items():
        np.testing.assert_array_equal(column.view(np.uint64), columns[name].view(np.uint64), name)


# --- co-simulation ------------------------------------------------------------------------------


def test_table_1_has_the_bits_of_fmi_2(fmus, table_results):
    with workers() as pool:
        jobs = start(pool, [replace(loop, fmi3=("all",)) for loop in table_results], fmus)
        results = {replace(loop, fmi3=()): job.get() for loop, job in jobs.items()}
    for loop, columns in table_results.items():
        assert_same_bits(results[loop], dict(columns))
    _, all_hold = table1.report(results)
    assert all_hold


@pytest.mark.parametrize("order", ["sequential", "parallel"])
@pytest.mark.parametrize("controller", ["Pid", "PidRbf", "IpidRbf"])
@pytest.mark.parametrize(
    "fmi3", [("all",), ("controller",), ("plant",), ("source",), ("plant", "source")], ids=str
)
def test_any_pairing_gives_the_same_bits(fmus, controller, fmi3, order):
    loop = Loop(controller, "sine", overrides=(("plant.theta0", 0.1),))
    expected = bits(loop, fmus, order=order)
    assert_same_bits(bits(replace(loop, fmi3=fmi3), fmus, order=order), expected)


def test_a_supervised_loop_of_both_versions_gives_the_same_bits(fmus):
    loop = Loop("IpidRbf", target="supervisor", w0=(0.1, 0.2, 0.3, 0.4), plant_model="nonlinear")
    mixed = replace(loop, fmi3=("supervisor", "plant"))
    assert_same_bits(bits(mixed, fmus), bits(loop, fmus))


def test_elements_of_arrays_can_be_recorded_in_any_order(fmus):
    names = ["controller.rbf.w[3]", "controller.u", "controller.rbf.h[1]", "controller.rbf.w[1]"]
    loop = Loop("PidRbf", "sine", w0=(1.0, 2.0, 3.0, 4.0))
    columns = bits(replace(loop, fmi3=("all",)), fmus, record=names)
    assert_same_bits(columns, bits(loop, fmus, record=names))
    assert columns["controller.rbf.w[3]"][0] != columns["controller.rbf.w[1]"][0]


def test_an_element_of_an_array_can_be_connected(fmus):
    def run(ending: str) -> dict[str, np.ndarray]:
        controller = Component("controller", fmus / f"PidRbf{ending}.fmu", {"rbf.w0[3]": 5.0})
        plant = Component("plant", fmus / f"Pendulum{ending}.fmu", {"theta0": 0.1})
        connections = [("controller.rbf.w[3]", "plant.u"), ("plant.theta", "controller.y")]
        with System([controller, plant], connections) as system:
            return simulate(system, TS, TS, 100)

    columns = run("_fmi3")
    assert_same_bits(columns, run(""))
    assert columns["plant.v"][1] > 0


def test_start_values_reach_single_elements(fmus):
    given = {"rbf.w0[2]": 7.0, "rbf.w0[4]": -1.0, "rbf.c[1]": "-3"}
    with Component("controller", fmus / "PidRbf_fmi3.fmu", given) as controller:
        controller.initialize(0.0)
        assert [controller.get(f"rbf.w[{j}]") for j in range(1, 5)] == [0.0, 7.0, 0.0, -1.0]
        assert [controller.get(f"rbf.c[{j}]") for j in range(1, 5)] == [-3.0, -1.0, 1.0, 2.0]


CENTRES = [-2.0, -1.0, 1.0, 2.0, 3.0, -3.0, 4.0, -4.0, 5.0, -5.0]
"""Centres of a network with ten nodes."""


def network(nodes: int) -> type[reference.Controller]:
    """Return the reference with another number of nodes."""

    class Network(reference.Controller):
        c, b = np.array(CENTRES[:nodes]), np.full(nodes, 0.5)

    return Network


@pytest.mark.parametrize("nodes", [1, 3, 4, 10])
@pytest.mark.parametrize("model", ["PidRbf", "IpidRbf"])
def test_networks_of_any_size_agree_with_the_reference(fmus, model, nodes):
    w0 = [0.5 * j for j in range(1, nodes + 1)]
    start = {f"rbf.w0[{j}]": weight for j, weight in enumerate(w0, start=1)}
    start |= {f"rbf.c[{j}]": centre for j, centre in enumerate(CENTRES[:nodes], start=1)}
    start |= {f"rbf.b[{j}]": 0.5 for j in range(1, nodes + 1)}
    expected = network(nodes)(model, w0=w0)
    with Component("c", fmus / f"{model}_fmi3.fmu", {**start, "rbf.nodes": nodes}) as controller:
        assert f"rbf.w[{nodes}]" in controller.outputs()
        assert f"rbf.w[{nodes + 1}]" not in controller.outputs()
        controller.initialize(0.0)
        for k in range(300):
            r, y = 3 * math.sin(0.05 * k), 2.9 * math.sin(0.05 * k - 0.02)
            controller.set("r", r)
            controller.set("y", y)
            controller.step(k * TS, TS)
            expected.sample(r, y)
            assert controller.get("u") == pytest.approx(expected.u, abs=1e-9)
            weights = [controller.get(f"rbf.w[{j}]") for j in range(1, nodes + 1)]
            np.testing.assert_allclose(weights, expected.w, rtol=0, atol=1e-9)


def test_an_array_whose_size_was_chosen_is_set_as_a_whole(fmus):
    given = {"rbf.nodes": 6, "rbf.w0[5]": 1.0}
    with pytest.raises(MasterError, match=r"rbf\.w0\[6\] needs a value, too"):
        Component("controller", fmus / "PidRbf_fmi3.fmu", given)


@pytest.mark.parametrize("nodes", [0, 17, -1, 2**64, 4.5, "many"])
def test_an_impossible_number_of_nodes_is_refused(fmus, nodes):
    with pytest.raises(MasterError, match=r"rbf\.nodes"):
        Component("controller", fmus / "PidRbf_fmi3.fmu", {"rbf.nodes": nodes})


@pytest.mark.parametrize(
    ("component", "given", "message"),
    [
        ("PidRbf", {"rbf.w0[5]": 1.0}, r"no variable rbf\.w0\[5\]; did you mean rbf\.w0\[\d\]"),
        ("PidRbf", {"rbf.w0": 1.0}, r"no variable rbf\.w0; did you mean rbf\.w0\[\d\]"),
        ("PidRbf", {"rbf.w0[1]": "big"}, "a number is expected"),
        ("PidRbf", {"anti_windup": "maybe"}, "true or false is expected"),
        ("PidRbf", {"rbf.w[1]": 1.0}, "only inputs and parameters can be set"),
        ("PidRbf", {"rbf.b[2]": -1.0}, r"fmi3SetFloat64 returned status \d: .*rbf\.b"),
        ("Pendulum", {"model": "cubic"}, "one of transfer_function, linear, nonlinear"),
    ],
)
def test_errors_name_the_variable_and_what_is_expected(fmus, component, given, message):
    with (
        pytest.raises(MasterError, match=message),
        Component(component, fmus / f"{component}_fmi3.fmu", given) as instance,
    ):
        instance.initialize(0.0)


def test_a_failed_step_names_the_fmu_the_time_and_the_reason(fmus):
    message = (
        r"plant \(Pendulum_fmi3\.fmu\), step of 0\.0015 s at t = 0\.001 s:"
        r" fmi3DoStep returned status \d: .*ts"
    )
    with (
        Loop("Pid", plant_model="transfer_function", fmi3=("all",)).system(fmus) as system,
        pytest.raises(MasterError, match=message),
    ):
        simulate(system, TS, 0.0015, 10)


def test_the_script_takes_fmus_of_both_versions(fmus, tmp_path):
    def run(*arguments: str) -> subprocess.CompletedProcess:
        command = [sys.executable, str(ROOT / "tests" / "master.py"), "--stop", "0.2"]
        return subprocess.run(
            [*command, *arguments], cwd=tmp_path, capture_output=True, text=True, check=False
        )

    expected = run().stdout
    assert "maximum |u|" in expected
    for arguments in (["--fmi3"], ["--fmi3", "plant"], ["--fmi3", "controller", "source"]):
        assert run(*arguments).stdout == expected
    assert "no component 'robot'" in run("--fmi3", "robot").stderr
    assert "run `cargo fmu export --fmi 3.0` first" in run("--fmi3", "--fmus", "nowhere").stderr


# --- descriptions -------------------------------------------------------------------------------


@pytest.mark.parametrize("ending", ["", "_fmi3"], ids=["2.0", "3.0"])
@pytest.mark.parametrize("model", MODELS)
def test_fmpy_finds_no_problems(fmus, model, ending):
    assert validate_fmu(str(fmus / f"{model}{ending}.fmu")) == []


@pytest.mark.parametrize("model", MODELS)
def test_both_versions_describe_the_same_variables(fmus, model):
    def variables(ending: str) -> dict:
        with Component("component", fmus / f"{model}{ending}.fmu") as component:
            return {
                name: (v.causality, v.variability, v.description, component.unit(name))
                for name, v in component.variables.items()
                if v.causality not in ("independent", "structuralParameter")
            }

    assert variables("_fmi3") == variables("")


def test_states_and_their_derivatives_are_those_of_fmi_2(fmus):
    def states(ending: str) -> dict[str, str]:
        path = fmus / f"Pendulum{ending}.fmu"
        derivatives = [d.variable for d in fmpy.read_model_description(path).derivatives]
        return {variable.name: variable.derivative.name for variable in derivatives}

    names = ("theta", "omega", "x", "v")
    assert states("") == states("_fmi3") == {f"der({name})": name for name in names}
