"""The Pendulum FMU alone, against closed forms and SciPy's integrators."""

import math
import re

import numpy as np
import pytest
from scipy.signal import lfilter

import reference
from pendulum_fmus.master import Component, MasterError, Reals

STATE = ("x", "v", "theta", "omega")
"""The outputs in the order of the reference's state."""

INITIAL = (0.3, -0.2, 0.1, 0.5)


def state(plant: Component) -> np.ndarray:
    """Return (x, v, theta, omega) of a Pendulum, in SI units."""
    outputs = Reals(plant, STATE)
    outputs.get()
    return np.array(outputs.values)


def start_values(values) -> dict[str, float]:
    """Return the initial state (x, v, theta, omega) as start values."""
    return {f"{name}0": value for name, value in zip(STATE, values, strict=True)}


def drive(plant: Component, forces, h: float) -> np.ndarray:
    """Apply each force [N] for h [s]; return the states after each, (steps, 4)."""
    states = []
    for k, u in enumerate(forces):
        plant.set("u", u)
        plant.step(k * h, h)
        states.append(state(plant))
    return np.array(states)


def forces(steps: int) -> np.ndarray:
    """Return a force [N] that excites every state, (steps,)."""
    return np.random.default_rng(7).uniform(-20, 20, steps)


@pytest.mark.parametrize("model", ["linear", "nonlinear"])
def test_outputs_start_at_the_initial_state(instance, model):
    plant = instance("Pendulum", {"model": model, **start_values(INITIAL)})
    np.testing.assert_array_equal(state(plant), INITIAL)


@pytest.mark.parametrize("h", [0.001, 1 / 1024, 0.01, 0.00025, 0.1, 3.0])
def test_linear_model_is_exact_for_any_step(instance, h):
    inputs, expected = forces(max(1, round(0.5 / h))), np.array(INITIAL)
    states = drive(instance("Pendulum", start_values(INITIAL)), inputs, h)
    for k, u in enumerate(inputs):
        expected = reference.linear_response(expected, u, h)
        np.testing.assert_allclose(states[k], expected, rtol=1e-10, atol=1e-12)


def test_linear_model_accepts_a_varying_step(instance):
    plant, time, expected = instance("Pendulum", start_values(INITIAL)), 0.0, np.array(INITIAL)
    plant.set("u", 3.0)
    for h in [0.001, 0.01, 0.001, 0.00025, 1 / 1024, 0.3, 0.001]:
        plant.step(time, h)
        time += h
        expected = reference.linear_response(expected, 3.0, h)
        np.testing.assert_allclose(state(plant), expected, rtol=1e-12)


def test_the_upright_pendulum_rests_and_diverges_at_the_rate_of_its_pole(instance):
    at_rest = drive(instance("Pendulum"), [0.0] * 100, 0.01)
    np.testing.assert_array_equal(at_rest, np.zeros((100, 4)))
    theta = drive(instance("Pendulum", {"theta0": 1e-3}), [0.0] * 400, 0.01)[:, 2]
    poles = np.roots([1, 0.0883166861244433, -27.828533748432577, -2.309421887836728])
    assert np.log(theta[-1] / theta[-101]) == pytest.approx(max(poles.real), rel=1e-6)


@pytest.mark.parametrize(
    ("initial", "h", "steps"),
    [
        (INITIAL, 0.01, 30),
        ((0, 1, 3.0, -2.0), 0.001, 200),
        ((1, -3, 0.5, 12.0), 1 / 1024, 200),
        ((0, 0, math.pi, 0), 0.01, 30),
        ((0.0, 0.5, 2.0, 3.0), 1.0, 1),
    ],
    ids=["small", "hanging", "spinning", "at the bottom", "one long step"],
)
def test_nonlinear_model_agrees_with_dop853(instance, initial, h, steps):
    inputs, expected = forces(steps), np.array(initial, float)
    plant = instance("Pendulum", {"model": "nonlinear", **start_values(initial)})
    for u, found in zip(inputs, drive(plant, inputs, h), strict=True):
        expected = reference.integrate(expected, u, h)
        np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize(
    ("parameter", "value"), [("M", 2.0), ("m", 0.3), ("l", 0.4), ("g", 1.6), ("I", 0.01), ("b", 3)]
)
def test_every_parameter_acts_as_in_the_equations(instance, monkeypatch, parameter, value):
    monkeypatch.setattr(reference, parameter, value)
    initial = (0.1, 0.2, 0.3, 0.4)
    caches = (reference.linear_model, reference.hold)
    try:
        for cached in caches:
            cached.cache_clear()
        models = {"linear": reference.linear_response, "nonlinear": reference.integrate}
        for model, respond in models.items():
            start = {"model": model, parameter: value, **start_values(initial)}
            states = drive(instance("Pendulum", start), [1.0] * 50, 0.01)
            np.testing.assert_allclose(states[-1], respond(np.array(initial), 1.0, 0.5), rtol=1e-8)
    finally:
        for cached in caches:
            cached.cache_clear()


# --- the transfer function ----------------------------------------------------------------------

TRANSFER = {"model": "transfer_function"}


@pytest.mark.parametrize("ts", [0.001, 0.005])
def test_transfer_function_gives_the_linear_angle_at_its_sample_time(instance, ts):
    inputs = forces(200)
    states = drive(instance("Pendulum", TRANSFER | {"ts": ts}), inputs, ts)
    linear = drive(instance("Pendulum"), inputs, ts)[:, 2]
    np.testing.assert_allclose(states[:, 2], linear, rtol=0, atol=1e-6 * np.max(np.abs(linear)))
    assert np.all(states[:, [0, 1, 3]] == 0), "the other outputs are not computed"


def test_transfer_function_is_the_difference_equation(instance):
    inputs = forces(1000)
    theta = drive(instance("Pendulum", TRANSFER), inputs, 0.001)[:, 2]
    # y(k+1) is the output of fmi2DoStep with u(k)
    expected = lfilter(*reference.difference_equation(), [*inputs, 0.0])[1:]
    np.testing.assert_allclose(theta, expected, rtol=0, atol=1e-5 * np.max(np.abs(expected)))


def test_transfer_function_takes_several_samples_in_a_step(instance):
    coarse = drive(instance("Pendulum", TRANSFER), [1.0] * 20, 0.01)[:, 2]
    fine = drive(instance("Pendulum", TRANSFER), [1.0] * 200, 0.001)[:, 2]
    np.testing.assert_allclose(coarse, fine[9::10], rtol=1e-12)


@pytest.mark.parametrize("h", [0.0015, 0.00025, 1 / 1024])
def test_transfer_function_rejects_a_step_that_is_not_a_multiple_of_its_sample_time(instance, h):
    plant = instance("Pendulum", TRANSFER)
    with pytest.raises(MasterError, match=r"status 3.*(multiple|whole number).*ts"):
        plant.step(0.0, h)


@pytest.mark.parametrize("jitter", [1e-13, -1e-13])
def test_transfer_function_tolerates_the_rounding_of_a_step(instance, jitter):
    plant = instance("Pendulum", TRANSFER)
    plant.set("u", 1.0)
    plant.step(0.0, 0.001 + jitter)
    assert state(plant)[2] == pytest.approx(1.1782445e-6, rel=1e-6)


@pytest.mark.parametrize(
    ("name", "value"), [("M", math.nan), ("M", -1.0), ("l", 0.0), ("ts", 0.0), ("g", math.inf)]
)
def test_invalid_parameters_are_rejected_by_name(instance, name, value):
    with pytest.raises(MasterError, match=rf"status 3: .*\b{re.escape(name)}"):
        instance("Pendulum", {name: value})
