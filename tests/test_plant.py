"""The Pendulum FMU alone, against closed forms and SciPy's integrators."""

import math
import re

import numpy as np
import pytest
from scipy.signal import lfilter

import reference
from pendulum_fmus.master import MasterError, Reals

STATE = ("x", "v", "theta", "omega")
"""The outputs in the order of the reference's state."""

RNG_SEED = 7

NAMED = r"status 3: .*\b{}"
"""The FMU's own message about a rejected variable."""


def state(plant) -> np.ndarray:
    """Return (x, v, theta, omega) of a Pendulum, in SI units."""
    outputs = Reals(plant, STATE)
    outputs.get()
    return np.array(outputs.values)


def start_values(values) -> dict[str, float]:
    """Return the initial state (x, v, theta, omega) as start values."""
    return {f"{name}0": value for name, value in zip(STATE, values, strict=True)}


def drive(plant, forces, h: float) -> np.ndarray:
    """Apply each force [N] for h [s]; return the states after each, (steps, 4)."""
    states = []
    for k, u in enumerate(forces):
        plant.set("u", u)
        plant.step(k * h, h)
        states.append(state(plant))
    return np.array(states)


def forces(steps: int) -> np.ndarray:
    """Return a force [N] that excites every state, (steps,)."""
    return np.random.default_rng(RNG_SEED).uniform(-20, 20, steps)


INITIAL = (0.3, -0.2, 0.1, 0.5)


@pytest.mark.parametrize("model", ["linear", "nonlinear"])
def test_outputs_start_at_the_initial_state(instance, model):
    plant = instance("Pendulum", {"model": model, **start_values(INITIAL)})
    np.testing.assert_array_equal(state(plant), INITIAL)


@pytest.mark.parametrize("h", [0.001, 1 / 1024, 0.01, 0.00025, 0.1])
def test_linear_model_is_exact_for_any_step(instance, h):
    inputs = forces(round(1 / h))
    states = drive(instance("Pendulum", start_values(INITIAL)), inputs, h)
    expected = np.array(INITIAL)
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


def test_one_large_step_equals_many_small_ones(instance):
    huge = drive(instance("Pendulum", start_values(INITIAL)), [2.0], 3.0)
    small = drive(instance("Pendulum", start_values(INITIAL)), [2.0] * 3000, 0.001)
    np.testing.assert_allclose(huge[-1], reference.linear_response(INITIAL, 2.0, 3.0), rtol=1e-10)
    np.testing.assert_allclose(small[-1], huge[-1], rtol=1e-10)


def test_the_upright_pendulum_rests_and_diverges_at_the_rate_of_its_pole(instance):
    at_rest = drive(instance("Pendulum"), [0.0] * 100, 0.01)
    np.testing.assert_array_equal(at_rest, np.zeros((100, 4)))
    theta = drive(instance("Pendulum", {"theta0": 1e-3}), [0.0] * 400, 0.01)[:, 2]
    poles = np.roots([1, 0.0883166861244433, -27.828533748432577, -2.309421887836728])
    assert np.log(theta[-1] / theta[-101]) == pytest.approx(max(poles.real), rel=1e-6)


@pytest.mark.parametrize(
    ("initial", "h"),
    [
        (INITIAL, 0.01),
        ((0, 0, 1.5, 0), 0.01),
        ((0, 1, 3.0, -2.0), 0.001),
        ((1, -3, 0.5, 12.0), 1 / 1024),
        ((0, 0, math.pi, 0), 0.01),
    ],
    ids=["small", "sideways", "hanging", "spinning", "at the bottom"],
)
def test_nonlinear_model_agrees_with_dop853(instance, initial, h):
    inputs = forces(round(0.5 / h))
    plant = instance("Pendulum", {"model": "nonlinear", **start_values(initial)})
    states = drive(plant, inputs, h)
    expected = np.array(initial, float)
    for k, u in enumerate(inputs):
        expected = reference.integrate(expected, u, h)
        np.testing.assert_allclose(states[k], expected, rtol=1e-8, atol=1e-9)


def test_nonlinear_model_handles_a_long_communication_step(instance):
    initial = (0.0, 0.5, 2.0, 3.0)
    plant = instance("Pendulum", {"model": "nonlinear", **start_values(initial)})
    states = drive(plant, [5.0], 1.0)
    expected = reference.integrate(np.array(initial), 5.0, 1.0)
    np.testing.assert_allclose(states[-1], expected, rtol=1e-7)


def energy(states: np.ndarray) -> np.ndarray:
    """Return kinetic and potential energy [J] of states (steps, 4)."""
    M, m, l, g, I = reference.M, reference.m, reference.l, reference.g, reference.I  # noqa: E741
    _, v, theta, omega = states.T
    kinetic = (M + m) * v**2 / 2 - m * l * v * omega * np.cos(theta) + (I + m * l**2) * omega**2 / 2
    return kinetic + m * g * l * np.cos(theta)


def test_nonlinear_model_conserves_energy_without_friction_and_force(instance):
    initial = (0.0, 0.4, 2.5, -3.0)
    plant = instance("Pendulum", {"model": "nonlinear", "b": 0.0, **start_values(initial)})
    states = drive(plant, [0.0] * 5000, 0.001)
    start = energy(np.array([initial]))[0]
    np.testing.assert_allclose(energy(states), start, rtol=0, atol=1e-8 * abs(start))
    assert np.ptp(states[:, 2]) > 1  # it does move


def test_friction_dissipates_energy(instance):
    plant = instance("Pendulum", {"model": "nonlinear", **start_values((0, 1, 2.5, 0))})
    assert np.all(np.diff(energy(drive(plant, [0.0] * 500, 0.01))) <= 0)


def test_nonlinear_model_converges_to_the_linear_one(instance):
    """The difference is of third order in the angle."""

    def difference(theta0: float) -> float:
        both = [
            drive(instance("Pendulum", {"model": model, "theta0": theta0}), [0.0] * 200, 0.001)
            for model in ("linear", "nonlinear")
        ]
        return float(np.max(np.abs(both[0][:, 2] - both[1][:, 2])))

    assert difference(0.01) / difference(0.1) == pytest.approx(1e-3, rel=0.03)


@pytest.mark.parametrize(
    ("parameter", "value"), [("M", 2.0), ("m", 0.3), ("l", 0.4), ("g", 1.6), ("I", 0.01), ("b", 3)]
)
def test_every_parameter_of_the_plant_has_an_effect(instance, monkeypatch, parameter, value):
    initial = (0.1, 0.2, 0.02, 0.3)
    monkeypatch.setattr(reference, parameter, value)
    models = {"linear": reference.linear_response, "nonlinear": reference.integrate}
    try:
        for model, respond in models.items():
            reference.linear_model.cache_clear()
            reference.hold.cache_clear()
            start = {"model": model, parameter: value, **start_values(initial)}
            states = drive(instance("Pendulum", start), [1.0] * 50, 0.01)
            np.testing.assert_allclose(states[-1], respond(np.array(initial), 1.0, 0.5), rtol=1e-8)
    finally:
        reference.linear_model.cache_clear()
        reference.hold.cache_clear()


# --- the transfer function ----------------------------------------------------------------------


def test_transfer_function_gives_the_linear_angle(instance):
    inputs = forces(1000)
    theta = drive(instance("Pendulum", {"model": "transfer_function"}), inputs, 0.001)[:, 2]
    linear = drive(instance("Pendulum"), inputs, 0.001)[:, 2]
    np.testing.assert_allclose(theta, linear, rtol=0, atol=1e-6 * np.max(np.abs(linear)))


def test_transfer_function_is_the_difference_equation(instance):
    inputs = forces(1000)
    theta = drive(instance("Pendulum", {"model": "transfer_function"}), inputs, 0.001)[:, 2]
    # y(k+1) is the output of fmi2DoStep with u(k)
    expected = lfilter(*reference.difference_equation(), [*inputs, 0.0])[1:]
    np.testing.assert_allclose(theta, expected, rtol=0, atol=1e-5 * np.max(np.abs(expected)))


def test_transfer_function_takes_several_samples_in_a_step(instance):
    coarse = drive(instance("Pendulum", {"model": "transfer_function"}), [1.0] * 20, 0.01)[:, 2]
    fine = drive(instance("Pendulum", {"model": "transfer_function"}), [1.0] * 200, 0.001)[:, 2]
    np.testing.assert_allclose(coarse, fine[9::10], rtol=1e-12)


def test_transfer_function_has_its_own_sample_time(instance):
    start = {"model": "transfer_function", "ts": 0.005}
    theta = drive(instance("Pendulum", start), forces(100), 0.005)[:, 2]
    linear = drive(instance("Pendulum"), forces(100), 0.005)[:, 2]
    np.testing.assert_allclose(theta, linear, rtol=0, atol=1e-6 * np.max(np.abs(linear)))


def test_transfer_function_leaves_the_other_outputs_at_zero(instance):
    states = drive(instance("Pendulum", {"model": "transfer_function"}), forces(50), 0.001)
    assert np.all(states[:, [0, 1, 3]] == 0)
    assert np.any(states[:, 2] != 0)


@pytest.mark.parametrize("h", [0.0015, 0.00025, 1 / 1024])
def test_transfer_function_rejects_a_step_that_is_not_a_multiple_of_its_sample_time(instance, h):
    plant = instance("Pendulum", {"model": "transfer_function"})
    with pytest.raises(MasterError, match=r"status 3.*(multiple|whole number).*ts"):
        plant.step(0.0, h)


@pytest.mark.parametrize("jitter", [1e-13, -1e-13])
def test_transfer_function_tolerates_the_rounding_of_a_step(instance, jitter):
    plant = instance("Pendulum", {"model": "transfer_function"})
    plant.set("u", 1.0)
    plant.step(0.0, 0.001 + jitter)
    assert state(plant)[2] == pytest.approx(1.1782445e-6, rel=1e-6)


@pytest.mark.parametrize(
    ("name", "value"), [("M", math.nan), ("M", -1.0), ("l", 0.0), ("ts", 0.0), ("g", math.inf)]
)
def test_invalid_parameters_are_rejected_by_name(instance, name, value):
    with pytest.raises(MasterError, match=NAMED.format(re.escape(name))):
        instance("Pendulum", {name: value})
