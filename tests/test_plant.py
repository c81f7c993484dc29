"""The Pendulum FMU alone, against closed forms and SciPy's integrators.

`test_master.py` and `test_c_interface.py` test what it refuses.
"""

import math
from collections.abc import Iterable

import numpy as np
import pytest
from scipy.signal import lfilter

import reference
from pendulum_fmus.master import Component, Reals

STATE = ("x", "v", "theta", "omega")
"""The outputs in the order of the reference's state."""

INITIAL = (0.3, -0.2, 0.1, 0.5)

RESPONSES = {"linear": reference.linear_response, "nonlinear": reference.integrate}


def state(plant: Component) -> np.ndarray:
    """Return (x, v, theta, omega) of a pendulum, in SI units."""
    outputs = Reals(plant, STATE)
    outputs.get()
    return np.array(outputs.values)


def pendulum(instance, initial: Iterable[float] = INITIAL, **start) -> Component:
    """Return a pendulum in an initial state."""
    values = {f"{name}0": value for name, value in zip(STATE, initial, strict=True)}
    plant = instance("Pendulum", values | start)
    np.testing.assert_array_equal(state(plant), initial)
    return plant


def drive(plant: Component, forces: Iterable[float], steps: Iterable[float]) -> np.ndarray:
    """Apply each force [N] for one of the steps [s]; return the states after each, (steps, 4)."""
    states, time = [], 0.0
    for u, h in zip(forces, steps, strict=False):
        plant.set("u", u)
        plant.step(time, h)
        time += h
        states.append(state(plant))
    return np.array(states)


def forces(steps: int) -> np.ndarray:
    """Return a force [N] that excites every state, (steps,)."""
    return np.random.default_rng(7).uniform(-20, 20, steps)


def test_linear_model_is_exact_for_any_step(instance):
    steps = [0.001, 0.01, 0.001, 0.00025, 1 / 1024, 0.3, 0.001, 3.0]
    states, expected = drive(pendulum(instance), forces(8), steps), INITIAL
    for u, h, found in zip(forces(8), steps, states, strict=True):
        expected = reference.linear_response(expected, u, h)
        np.testing.assert_allclose(found, expected, rtol=1e-10)


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
    states = drive(pendulum(instance, initial, dynamics="nonlinear"), forces(steps), [h] * steps)
    for u, found in zip(forces(steps), states, strict=True):
        initial = reference.integrate(initial, u, h)
        np.testing.assert_allclose(found, initial, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize(
    ("parameter", "value"), [("M", 2.0), ("m", 0.3), ("l", 0.4), ("g", 1.6), ("I", 0.01), ("b", 3)]
)
def test_every_parameter_acts_as_in_the_equations(instance, monkeypatch, parameter, value):
    monkeypatch.setattr(reference, parameter, value)
    # Without their caches
    monkeypatch.setattr(reference, "linear_model", reference.linear_model.__wrapped__)
    monkeypatch.setattr(reference, "hold", reference.hold.__wrapped__)
    for model, respond in RESPONSES.items():
        plant = pendulum(instance, dynamics=model, **{parameter: value})
        states = drive(plant, [1.0] * 50, [0.01] * 50)
        np.testing.assert_allclose(states[-1], respond(np.array(INITIAL), 1.0, 0.5), rtol=1e-8)


@pytest.mark.parametrize("ts", [0.001, 0.005])
def test_the_transfer_function_is_the_difference_equation(instance, ts):
    inputs = forces(600)
    start = {"dynamics": "transfer_function", "ts": ts}
    states = drive(instance("Pendulum", start), inputs, [ts, ts + 1e-13, ts - 1e-13] * 200)
    # y(k+1) is the output of fmi2DoStep with u(k)
    theta = lfilter(*reference.difference_equation(ts), [*inputs, 0.0])[1:]
    np.testing.assert_allclose(states[:, 2], theta, rtol=0, atol=1e-5 * np.max(np.abs(theta)))
    assert np.all(states[:, [0, 1, 3]] == 0), "the other outputs are not computed"
    several = drive(instance("Pendulum", start), inputs[::10], [10 * ts] * 60)
    single = drive(instance("Pendulum", start), np.repeat(inputs[::10], 10), [ts] * 600)
    np.testing.assert_allclose(several, single[9::10], rtol=1e-12)
