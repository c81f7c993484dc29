"""Algebraic loops and strong coupling that the master iterates, against closed forms.

The FMU in C is `body.c` of FMI 2.0, whose outputs `y`, `force` and `on` depend directly on inputs.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import brentq

from fmu_master import FmuError, System
from native import SOURCES, in_c, refusal, replaced, run, write_system

XML = (SOURCES / "body.xml").read_text(encoding="utf-8")
WITHOUT_DERIVATIVES = {'providesDirectionalDerivative="true"': ""}
WITHOUT_STATE = {'canGetAndSetFMUstate="true"': ""}

Build = Callable[..., Path]


@pytest.fixture(
    scope="module", params=[{}, WITHOUT_DERIVATIVES], ids=["derivatives", "differences"]
)
def body(request, once) -> Path:
    """Return the FMU, with or without directional derivatives."""
    folder = once(
        f"body-{len(request.param)}",
        lambda folder: in_c(folder / "Body.fmu", xml=replaced(XML, request.param)),
    )
    return folder / "Body.fmu"


def system(
    fmu: Path, starts: Mapping[str, Mapping[str, Any]], connections: list[Any], **keys: Any
) -> System:
    """Return a system of bodies with start values."""
    components = {name: {"fmu": fmu, "start": dict(start)} for name, start in starts.items()}
    components = {n: {**c, **keys.pop(n, {})} for n, c in components.items()}
    defaults = {"stop": 1.0, "step": 0.125, "algebraic_loops": "iterate"}
    return System(components=components, connections=connections, **{**defaults, **keys})


LOOP = ["a.y -> b.u", "b.y -> a.u"]
INTERFACES = pytest.mark.parametrize("interface", ["co-simulation", "model-exchange"])


@INTERFACES
@pytest.mark.parametrize("gains", [(0.5, -0.25), (3.0, -2.0), (-20.0, 30.0), (1.0, 0.999)])
def test_a_linear_loop_of_any_gain_is_solved_at_all_times(body, gains, interface):
    """y_a = a y_b + 1 and y_b = b y_a + 0.5, also at the start."""
    a, b = gains
    starts = {"a": {"gain": a, "bias": 1.0}, "b": {"gain": b, "bias": 0.5}}
    result = system(body, starts, LOOP).simulate(interface=interface)
    expected = (a * 0.5 + 1.0) / (1.0 - a * b)
    assert len(result["time"]) == 9
    np.testing.assert_allclose(result["a.y"], expected, rtol=3e-6)
    np.testing.assert_allclose(result["b.y"], b * expected + 0.5, rtol=3e-6, atol=1e-6)


@INTERFACES
def test_the_outputs_of_a_loop_agree_at_each_row_while_it_moves(body, interface):
    """The force of b is c (x - p), and a returns p = 2 force: force = c x / (1 + 2 c)."""
    c, k = 5.0, 4.0
    starts = {"a": {"gain": 2.0}, "b": {"c": c, "k": k, "x": 1.0}}
    moving = system(body, starts, ["b.force -> a.u", "a.y -> b.p"], step=1 / 256)
    result = moving.simulate(interface=interface)
    np.testing.assert_allclose(result["b.force"], c * result["b.x"] / (1 + 2 * c), atol=3e-6)
    frequency = np.sqrt(k + c / (1 + 2 * c))
    # The input is held in each step, which is of first order.
    np.testing.assert_allclose(result["b.x"], np.cos(frequency * result["time"]), atol=0.02)


@INTERFACES
def test_a_nonlinear_loop_is_solved(body, interface):
    """y_a = 1 - 2 y_b^2 and y_b = 3 y_a - 0.5."""
    starts = {"a": {"curve": -2.0, "bias": 1.0}, "b": {"gain": 3.0, "bias": -0.5}}
    result = system(body, starts, LOOP).simulate(interface=interface)
    expected = brentq(lambda y: 1.0 - 2.0 * (3.0 * y - 0.5) ** 2 - y, 0.0, 1.0)
    other = brentq(lambda y: 1.0 - 2.0 * (3.0 * y - 0.5) ** 2 - y, -1.0, 0.0)
    found = result["a.y"]
    nearest = np.where(abs(found - expected) < abs(found - other), expected, other)
    np.testing.assert_allclose(found, nearest, atol=1e-5)
    assert np.ptp(found) < 1e-5  # the same solution throughout


def held(m: float, k: float, d: float, c: float, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Return A and B of (x, v) after a step with constant inputs (f, p)."""
    continuous = np.zeros((4, 4))
    continuous[0, 1] = 1.0
    continuous[1] = [-(k + c) / m, -d / m, 1.0 / m, c / m]
    discrete = expm(step * continuous)
    return discrete[:2, :2], discrete[:2, 2:]


def test_two_coupled_masses_are_those_of_the_implicit_scheme(body):
    """Each is exact for inputs that are the outputs after the step; this stiff spring is stable."""
    step, c, d = 0.1, 1e4, 20.0
    starts = {"a": {"m": 1.0, "k": 10.0, "x": 1.0}, "b": {"m": 2.0, "k": 5.0, "c": c}}
    starts = {name: {**start, "d": d} for name, start in starts.items()}
    connections = ["b.force -> a.f", "a.x -> b.p"]
    coupled = system(body, starts, connections, order="implicit", stop=2.0, step=step)
    result = coupled.simulate(loop_tolerance=1e-10)
    (aa, ab), (ba, bb) = held(1.0, 10.0, d, 0.0, step), held(2.0, 5.0, d, c, step)
    a, b = np.array([1.0, 0.0]), np.zeros(2)
    for row in range(len(result["time"])):
        assert result["a.x"][row] == pytest.approx(a[0], abs=1e-6), row
        assert result["b.x"][row] == pytest.approx(b[0], abs=1e-6), row
        # The state after the step: a = aa a + ab c (x_b - x_a), b = ba b + bb x_a.
        matrix = np.eye(4)
        matrix[:2, 0] += ab[:, 0] * c
        matrix[:2, 2] -= ab[:, 0] * c
        matrix[2:, 0] -= bb[:, 1]
        after = np.linalg.solve(matrix, np.concatenate([aa @ a, ba @ b]))
        a, b = after[:2], after[2:]
    # In sequential order, the same coupling is unstable.
    explicit = coupled.simulate(order="sequential", algebraic_loops="refuse")
    assert abs(explicit["a.x"][-1]) > 1e6


def test_a_sampled_component_takes_its_sample_before_the_step_also_in_implicit_order(body):
    starts = {"a": {"gain": 2.0, "bias": 1.0}, "b": {"gain": 0.45}}
    delayed = system(
        body, starts, LOOP, order="implicit", a={"sampled": True}, b={"sampled": False}
    )
    with pytest.raises(FmuError, match="algebraic loop"):
        delayed.simulate(algebraic_loops="refuse")
    result = delayed.simulate(algebraic_loops="delay")
    assert result["a.y"][-1] < 9.0  # slowly to 1 / (1 - 2 * 0.45)
    np.testing.assert_allclose(delayed.simulate()["a.y"], 10.0, rtol=1e-5)


@INTERFACES
def test_booleans_in_a_loop_settle_or_are_named(body, interface):
    links = ["a.on -> b.b", "b.on -> a.b"]
    both = {"a": {"invert": True}, "b": {"invert": True}}
    result = system(body, both, links).simulate(interface=interface)
    assert (result["a.on"] != result["b.on"]).all()
    flips = system(body, {"a": {"invert": True}, "b": {}}, links)
    with pytest.raises(FmuError, match=r"the loop of b\.on is not solved after 50 iterations"):
        flips.simulate(interface=interface)


def test_a_loop_without_a_solution_names_its_variables_the_residual_and_the_time(body):
    starts = {"a": {"gain": 1.0, "bias": 1.0}, "b": {"gain": 1.0}}
    expected = (
        r"the loop of b\.y is not solved after 7 iterations during the initialization: "
        r"b\.y still differs by 1\.000e0 from its guess"
    )
    with pytest.raises(FmuError, match=expected):
        system(body, starts, LOOP).simulate(loop_iterations=7)
    starts = {"a": {"gain": 1.0}, "b": {"gain": 1.0}}
    late = [{"from": "a.y", "to": "b.u", "faults": [{"offset": 1.0, "start": 0.5}]}, LOOP[1]]
    with pytest.raises(FmuError, match=r"in the step of 0\.125 s from t = 0\.5 s: b\.y"):
        system(body, starts, late).simulate()


def test_faults_act_once_in_each_step_that_is_repeated(body):
    """An offset from 0.5 s on arrives a step later: the memory of a delay returns with the step."""
    faults = [{"offset": 1.0, "start": 0.5}, {"delay": 0.125}]
    late = [{"from": "a.y", "to": "b.u", "faults": faults}, LOOP[1]]
    starts = {"a": {"gain": 0.5, "bias": 1.0}, "b": {"gain": 0.5, "bias": 0.25}}
    result = system(body, starts, late).simulate()
    expected = [1.5]  # a = 0.5 (0.5 a + 0.25) + 1
    passed = 1.5
    for time in result["time"][:-1]:
        expected.append(0.5 * (0.5 * passed + 0.25) + 1.0)
        passed = expected[-1] + (time >= 0.5)
    np.testing.assert_allclose(result["a.y"], expected, atol=1e-5)
    noisy = [{"from": "a.y", "to": "b.u", "faults": [{"noise": 0.1}]}, LOOP[1]]
    once, again = (system(body, starts, noisy, seed=3).simulate()["a.y"] for _ in range(2))
    np.testing.assert_array_equal(once, again)
    assert np.std(once[1:]) > 0.01


def test_a_component_that_cannot_repeat_a_step_is_named_before_the_first_step(tmp_path):
    fmu = in_c(tmp_path / "Body.fmu", xml=replaced(XML, WITHOUT_STATE))
    starts = {"a": {"gain": 3.0, "bias": 1.0}, "b": {"gain": -2.0}}
    stateless = system(fmu, starts, LOOP)
    expected = (
        r"a \(Body\.fmu\) cannot repeat a step to iterate the loop of b\.y: "
        r"its model description does not declare canGetAndSetFMUstate"
    )
    with pytest.raises(FmuError, match=expected):
        stateless.simulate()
    # Model exchange sets inputs and gets outputs at communication points instead.
    result = stateless.simulate(interface="model-exchange")
    np.testing.assert_allclose(result["a.y"], 1.0 / 7.0, rtol=1e-6)


def test_loops_are_refused_delayed_or_iterated(body, tmp_path):
    starts = {"a": {"gain": 0.5, "bias": 1.0}, "b": {"gain": 0.5}}
    system_file = write_system(tmp_path, starts, LOOP, fmu=str(body.with_suffix("")))
    said = refusal(tmp_path, "simulate", system_file)
    assert "a.y -> b.y -> a.y" in said or "b.y -> a.y -> b.y" in said
    assert 'algebraic_loops = "iterate" solves it' in said
    for how, expected in (("iterate", "1.333333"), ("delay", "1.333")):
        assert expected in run("simulate", system_file, "--algebraic-loops", how).stdout
    for options, expected in (
        (["--algebraic-loops=iterate", "--order=parallel"], 'order = "parallel", expected another'),
        (["--algebraic-loops=iterate", "--loop-tolerance=0"], "loop_tolerance = 0 is invalid"),
        (["--algebraic-loops=iterate", "--loop-iterations=0"], "loop_iterations = 0, expected"),
    ):
        assert expected in refusal(tmp_path, "simulate", system_file, *options)
