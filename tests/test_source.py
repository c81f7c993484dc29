"""The Source FMU alone: references and the disturbance at any time."""

import math

import numpy as np
import pytest

import reference
from pendulum_fmus.loop import TS
from pendulum_fmus.master import Component, Reals


def signals(source: Component) -> tuple[float, float]:
    """Return (r, d) [rad]."""
    outputs = Reals(source, ["r", "d"])
    outputs.get()
    return tuple(outputs.values)


@pytest.mark.parametrize(
    ("signal", "frequency", "h"),
    [("step", 0.2, TS), ("sine", 0.2, 0.01), ("square", 0.1, TS), ("square", 0.1, 1 / 1024)],
)
def test_signals_follow_their_formulas(instance, signal, frequency, h):
    start = {"signal": signal, "frequency": frequency, "disturbance.amplitude": 1.0}
    source = instance("Source", start)
    for k in range(round(10.5 / h)):
        r, d = reference.reference(signal, k * h, frequency), reference.disturbance(k * h, 1.0)
        assert signals(source) == pytest.approx((r, d), rel=1e-12, abs=1e-14), k * h
        source.step(k * h, h)


@pytest.mark.parametrize("time", [0.0, 0.001, 1.25, 5.0, 5.4, 1e6])
def test_after_initialization_the_signals_have_their_values_at_the_start_time(instance, time):
    source = instance("Source", {"signal": "sine", "disturbance.amplitude": 2.0}, time=time)
    expected = math.sin(2 * math.pi * 0.2 * time), reference.disturbance(time, 2.0)
    assert signals(source) == pytest.approx(expected, abs=1e-9)


def test_amplitude_frequency_and_pulse_are_parameters(instance):
    start = {
        "signal": "square",
        "amplitude": 3.0,
        "frequency": 2.0,
        "disturbance.amplitude": -0.5,
        "disturbance.start": 0.1,
        "disturbance.duration": 0.2,
    }
    source = instance("Source", start, time=0.05)
    seen = [signals(source)]
    for k in range(5):
        source.step(0.05 + k * 0.1, 0.1)
        seen.append(signals(source))
    # at 0.05, 0.15, 0.25 (the jump, where the old value holds), 0.35, 0.45, 0.55 s
    assert seen == [(3, 0), (3, -0.5), (3, -0.5), (-3, 0), (-3, 0), (3, 0)]


@pytest.mark.parametrize("jitter", [1e-13, -1e-13])
def test_a_jump_does_not_depend_on_the_rounding_of_time(instance, jitter):
    start = {"signal": "square", "frequency": 0.1, "disturbance.amplitude": 1.0}
    source = instance("Source", start, time=4.9)
    source.step(4.9, 0.1 + jitter)
    assert signals(source) == (1, 1)
    source.step(5.0 + jitter, 0.5)
    assert signals(source) == (-1, 0)


def test_one_large_step_equals_many_small_ones(instance):
    one, many = instance("Source", {"signal": "sine"}), instance("Source", {"signal": "sine"})
    one.step(0.0, 3.0)
    for k in range(300):
        many.step(k * 0.01, 0.01)
    np.testing.assert_allclose(signals(one), signals(many), rtol=0, atol=1e-12)
