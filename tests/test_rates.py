"""Steps of components, rows at other points than the steps, and extrapolated inputs."""

from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

from fmu_master import FmuError, System, python_component
from native import in_c, read_csv, refusal, run, write_system
from pendulum_fmus.project import FMUS
from reference import Plant, linear_model

STEP = 0.001
"""Communication step of most systems [s]."""

same = np.testing.assert_array_equal

pytestmark = pytest.mark.usefixtures("fmus")


def loop(plant: dict[str, object], controller: dict[str, object], **keys: object) -> System:
    """Return the linear pendulum under PID control, for 0.3 s."""
    start = {"theta0": 0.1, "dynamics": "linear"}
    components = {
        "controller": {"fmu": FMUS / "Pid.fmu", **controller},
        "plant": {"fmu": FMUS / "Pendulum.fmu", "start": start, **plant},
    }
    connections = [("plant.theta", "controller.y"), ("controller.u", "plant.u")]
    times = {"step": STEP, "stop": 0.3}
    return System(components=components, connections=connections, **(times | keys))


def falling() -> Plant:
    """Return the exact linear pendulum at the same angle."""
    plant = Plant("linear")
    plant.state = np.array([0, 0, 0.1, 0])
    return plant


def columns(result: object) -> dict[str, np.ndarray]:
    return {name: np.asarray(result[name]) for name in ("time", "plant.theta", "controller.u")}


def proportional(step: float) -> dict[str, object]:
    """Return a controller with this step, whose force is the angle times 60."""
    return {"fmu": python_component(["y"], ["u"], lambda _, y: -60.0 * y), "step": step}


@pytest.mark.parametrize("order", ["sequential", "parallel"])
def test_a_step_that_is_the_communication_step_changes_no_bit(order):
    plain = columns(loop({}, {}, order=order).simulate())
    for step in (STEP, "default experiment"):
        stepped = columns(loop({"step": step}, {"step": STEP}, order=order).simulate())
        for name, values in plain.items():
            same(stepped[name], values, err_msg=name)


def test_a_fast_plant_and_a_slow_controller_are_the_same_system():
    fast = columns(loop({"step": 1e-4}, {}).simulate())
    slow = columns(loop({}, {"step": STEP}, step=1e-4, output_step=STEP).simulate())
    np.testing.assert_allclose(slow.pop("time"), fast.pop("time"), rtol=1e-15)
    for name, values in fast.items():
        same(slow[name], values, err_msg=name)


def test_a_slow_controller_holds_its_output_as_the_exact_discrete_system_does():
    every = 10
    result = loop({}, proportional(every * STEP), stop=0.2).simulate()
    plant, u, theta, force = falling(), 0.0, [], []
    for k in range(201):
        u = -60.0 * plant.theta if k % every == 0 else u
        theta.append(plant.theta)
        force.append(u)
        plant.step(u, STEP)
    np.testing.assert_allclose(result["plant.theta"], theta, rtol=1e-11, atol=1e-14)
    np.testing.assert_allclose(result["controller.u"], force, rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("order", ["sequential", "parallel"])
def test_the_outputs_of_a_slow_plant_are_seen_when_its_step_ends(order):
    """A display steps with the system; a plant without force falls in steps of 5 ms."""
    seen = []
    components = {
        "plant": {
            "fmu": FMUS / "Pendulum.fmu",
            "start": {"theta0": 0.1, "dynamics": "linear"},
            "step": 0.005,
        },
        "display": python_component(["y"], ["x"], lambda t, y: seen.append((t, y)) or y),
    }
    system = System(
        components=components,
        connections=[("plant.theta", "display.y")],
        step=STEP,
        stop=0.012,
        order=order,
    )
    result = system.simulate()
    plant = falling()
    exact = [plant.theta]
    for _ in range(2):
        plant.step(0.0, 0.005)
        exact.append(plant.theta)
    held = [exact[k // 5] for k in range(13)]
    np.testing.assert_allclose(result["plant.theta"], held, rtol=1e-11)
    # In sequential order the display sees the outputs at the end of the communication step.
    ahead = 1 if order == "sequential" else 0
    expected = [exact[min((k + ahead) // 5, 2)] for k in range(13)]
    np.testing.assert_allclose([y for _, y in seen], expected, rtol=1e-11)
    np.testing.assert_allclose([t for t, _ in seen], np.arange(13) * STEP, atol=1e-15)


def test_a_component_of_model_exchange_has_steps_of_its_own():
    result = loop({"interface": "model-exchange", "step": STEP / 4}, {}, stop=0.1).simulate()
    expected = loop({}, {}, stop=0.1).simulate()
    np.testing.assert_allclose(result["plant.theta"], expected["plant.theta"], rtol=1e-9)


def test_functions_and_tables_have_the_times_of_a_component():
    seen = []
    fast = python_component(["x"], ["y"], lambda t, x: seen.append((t, x)) or x)
    system = System(components={"c": {"fmu": fast, "step": 0.025}}, step=0.1, stop=0.2)
    result = system.simulate(input={"time": [0.0, 1.0], "c.x": [0.0, 8.0]})
    times = np.arange(12) * 0.025
    np.testing.assert_allclose([t for t, _ in seen], times, atol=1e-15)
    np.testing.assert_allclose([x for _, x in seen], 8 * times, atol=1e-14)
    # A row has the last sample before the next communication point.
    np.testing.assert_allclose(result["c.y"], 8 * times[3::4], atol=1e-14)


def test_a_sample_that_ends_after_the_stop_time_is_told_to_the_fmu(tmp_path):
    """The step of a component that is not sampled is left out instead."""
    in_c(tmp_path / "Adaptive.fmu")
    for sampled, stop in ((False, 1.0), (True, 1.2)):
        own = {"sampled": sampled, "step": 0.6}
        system = write_system(
            tmp_path, {"a": {}}, fmu="Adaptive", own=own, step=0.1, outputs=["a.stop", "a.y"]
        )
        run("simulate", system, "--csv", "out.csv", cwd=tmp_path)
        found = read_csv(tmp_path / "out.csv")
        assert set(found["a.stop"]) == {stop}
        changes = np.flatnonzero(np.diff(found["a.y"]))
        assert list(changes) == [5]


def test_rows_are_at_multiples_of_the_output_step_and_the_summary_is_that_of_all_points(tmp_path):
    system = loop({}, {}, stop=0.25)
    every, some = system.simulate(), system.simulate(output_step=0.1)
    assert list(some["time"]) == [0.0, 0.1, 0.2]
    same(some["plant.theta"], every["plant.theta"][::100])
    assert some.summary == every.summary
    (tmp_path / "loop.toml").write_text(system.toml)
    told = [
        run("simulate", "loop.toml", *csv, cwd=tmp_path).stdout
        for csv in ([], ["--output-step=0.1"])
    ]
    same_lines = [line for line in told[0].splitlines() if " ms: " not in line]
    assert same_lines == [line for line in told[1].splitlines() if " ms: " not in line]
    run("simulate", "loop.toml", "--csv=few.csv", "--output-step=0.1", cwd=tmp_path)
    assert list(read_csv(tmp_path / "few.csv")["time"]) == [0.0, 0.1, 0.2]


def cascade(communication_step: float, *, order: str, version: str, **keys: object) -> float:
    """Return the error of the angle of a pendulum whose force is 20 times the angle of another."""
    start = {"theta0": 0.1, "dynamics": "linear"}
    pushed = {"fmu": FMUS / f"Pendulum{version}.fmu", "start": {"dynamics": "linear"}, **keys}
    system = System(
        components={"pushed": pushed, "falling": {"fmu": FMUS / "Pendulum.fmu", "start": start}},
        connections=[{"from": "falling.theta", "to": "pushed.u", "factor": 20.0, "offset": 0.5}],
        step=communication_step,
        stop=0.4,
        order=order,
    )
    (a, b), state = linear_model(), np.zeros(9)
    state[6], state[8] = 0.1, 1.0
    together = np.zeros((9, 9))
    together[:4, :4] = together[4:8, 4:8] = a
    together[:4, 6], together[:4, 8] = 20 * b, 0.5 * b
    exact = (expm(together * 0.4) @ state)[2]
    return abs(system.simulate()["pushed.theta"][-1] - exact)


def test_extrapolated_inputs_have_errors_of_second_order():
    """An FMU of FMI 2.0 receives the slope of its input; FMI 3.0 has no function for it."""
    for order, version, keys in (
        ("parallel", "", {}),
        ("sequential", "", {}),
        ("sequential", "", {"step": 0.04}),
    ):
        plain = {"order": order, "version": version}
        extrapolated = plain | keys | {"inputs": "extrapolated"}
        one, two = (cascade(size, **extrapolated) for size in (0.04, 0.02))
        if not keys:
            assert 3.5 < one / two < 4.5
        assert one < cascade(0.04, **plain) / 5


def test_inputs_are_extrapolated_at_each_step_of_a_component_without_slopes():
    keys = {"order": "parallel", "version": "_fmi3", "step": 0.001}
    held = cascade(0.04, **keys)
    extrapolated = cascade(0.04, **keys, inputs="extrapolated")
    assert extrapolated < held / 5


def test_inputs_without_derivatives_are_not_extrapolated():
    with pytest.raises(
        FmuError, match=r"component plant: inputs = \"extrapolated\", but no contin"
    ):
        loop({"inputs": "extrapolated"}, {}).simulate()
    with pytest.raises(FmuError, match='inputs = \'linear\', expected "held" or "extrapolated"'):
        loop({"inputs": "linear"}, {})
    # A fault would be gone.
    system = loop({}, {"inputs": "extrapolated"})
    system.simulate()
    faulty = {"from": "plant.theta", "to": "controller.y", "faults": [{"delay": 0.002}]}
    with pytest.raises(FmuError, match="component controller: inputs"):
        system.changed(connections=[faulty, ("controller.u", "plant.u")]).simulate()


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"step": 3e-4}, r"component plant: step = 0\.0003, expected a multiple or a whole frac"),
        ({"step": -1.0}, r"component plant: step = -1\.0, expected a positive number of s"),
        ({"step": "own"}, "component plant: step = 'own', expected a number, in s, or \"default"),
    ],
)
def test_a_step_that_does_not_fit_is_refused(keys, message):
    with pytest.raises(FmuError, match=message):
        loop(keys, {}).simulate()


def test_an_output_step_that_is_no_multiple_is_refused(tmp_path):
    with pytest.raises(FmuError, match=r"output_step = 0\.0015, expected a multiple of the comm"):
        loop({}, {}, output_step=0.0015).simulate()
    (tmp_path / "loop.toml").write_text(loop({"step": 0.4}, {}, step=0.1, stop=1).toml)
    said = refusal(tmp_path, "simulate", "loop.toml", "--step=0.3")
    assert "component plant: step = 0.4, expected a multiple or a whole fraction" in said
    (tmp_path / "loop.toml").write_text(
        loop({}, {}).toml.replace("[[component]]", '[[component]]\nstep = "own"')
    )
    said = refusal(tmp_path, "simulate", "loop.toml")
    assert 'expected a number of s, or "default experiment"' in said


def test_a_default_experiment_without_a_step_is_refused(tmp_path):
    in_c(Path(tmp_path / "Adaptive.fmu"))
    own = {"step": "default experiment"}
    said = refusal(tmp_path, "simulate", write_system(tmp_path, {"a": {}}, fmu="Adaptive", own=own))
    assert 'component a: step = "default experiment", but Adaptive.fmu has no step size' in said
