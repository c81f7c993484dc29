"""The blocks of `control-blocks` in an FMU give the numbers of SciPy."""

from pathlib import Path

import fmpy
import numpy as np
import pytest
from scipy import signal
from scipy.interpolate import RegularGridInterpolator

from native import run

DT, N = 0.01, 500
TIMES = np.arange(N) * DT
RANDOM = np.random.default_rng(1)
U, V = np.cumsum(RANDOM.normal(size=(2, N)), axis=1) * 0.3


@pytest.fixture(scope="module", params=["", "_fmi3"], ids=["FMI 2.0", "FMI 3.0"])
def y(request, blocks: Path):
    """Return the outputs of all blocks: sample k is that of the step from k `DT` on."""
    # The inputs hold over a step of FMPy if they jump at its start.
    kind = [("time", float), ("u", float), ("v", float)]
    times = np.repeat(np.arange(N + 1) * DT, 2)[1:-1]
    inputs = np.array([*zip(times, np.repeat(U, 2), np.repeat(V, 2), strict=True)], dtype=kind)
    values = {"first_order.time_constant": 0.05, "second_order.natural_frequency": 8.0}
    values |= {"second_order.damping": 0.3, "second_order.prewarp": 8.0, "lead_lag.lead": 0.3}
    values |= {"lead_lag.lag": 0.1, "lead_lag.gain": 2.0, "high_pass.time_constant": 0.2}
    return fmpy.simulate_fmu(
        blocks / f"Bench{request.param}.fmu",
        stop_time=N * DT,
        step_size=DT,
        output_interval=DT,
        input=inputs,
        start_values=values,
    )[1:]


def element(y, name: str, i: int):
    """Return an element of an array, which only has a name of its own in FMI 2.0."""
    return y[name][:, i] if name in y.dtype.names else y[f"{name}[{i + 1}]"]


def tustin(numerator, denominator, prewarp=0.0):
    """Return the response to U of a continuous filter, discretized by SciPy."""
    rate = prewarp / (2 * np.tan(prewarp * DT / 2)) if prewarp else 1 / DT
    return signal.lfilter(*signal.bilinear(numerator, denominator, rate), U)


def test_the_examples_are_valid(blocks: Path) -> None:
    files = [blocks / f"{name}.fmu" for name in ("Bench", "Bench_fmi3", "Servo", "Servo_fmi3")]
    assert run("validate", "--quick", *files).stdout.count("no error") == len(files)


def test_filters_are_those_of_scipy(y) -> None:
    w = 8.0
    for name, expected in {
        "first_order": tustin([1], [0.05, 1]),
        "second_order": tustin([w * w], [1, 2 * 0.3 * w, w * w], prewarp=w),
        "high_pass": tustin([0.2, 0], [0.2, 1]),
        "lead_lag": tustin([0.6, 2], [0.1, 1]),
    }.items():
        np.testing.assert_allclose(y[f"y.{name}"], expected, atol=1e-10, err_msg=name)
    average = signal.lfilter(np.ones(5) / 5, 1, U)
    np.testing.assert_allclose(y["y.average"][4:], average[4:], atol=1e-12)


def test_tables_are_those_of_numpy_and_scipy(y) -> None:
    expected = np.interp(U, [-2, -1, 0.5, 2], [4, 1, 0, 3])
    np.testing.assert_allclose(y["y.table1"], expected, atol=1e-12)
    axes = [-1, 0, 2], [-2, 1]
    grid = RegularGridInterpolator(axes, [[1, 2], [3, -1], [0.5, 4]])
    expected = grid(np.column_stack([np.clip(U, -1, 2), np.clip(V, -2, 1)]))
    np.testing.assert_allclose(y["y.table2"], expected, atol=1e-12)


def test_a_system_in_state_space_is_that_of_scipy(y) -> None:
    matrices = [[0.9, 0.1], [-0.2, 0.8]], [[0.5], [1]], [[1, 0], [1, -1]], [[0], [0.25]]
    _, expected, _ = signal.dlsim((*matrices, DT), U)
    for i in range(2):
        found = element(y, "y.state_space", i)
        np.testing.assert_allclose(found, expected[:, i], atol=1e-11)


def test_the_kalman_filter_is_that_of_the_textbook(y) -> None:
    a, b, c = np.array([[1, 0.01], [0, 1]]), np.array([0, 0.01]), np.array([[1.0, 0]])
    q, r = np.diag([1e-4, 1e-2]), np.array([[0.1]])
    x, p = np.zeros(2), np.eye(2)
    for k in range(N):
        if k:
            x, p = a @ x + b * V[k], a @ p @ a.T + q
        gain = p @ c.T @ np.linalg.inv(c @ p @ c.T + r)
        x, p = x + gain @ (U[k] - c @ x), p - gain @ c @ p
        found = [element(y, "y.kalman", i)[k] for i in range(2)]
        np.testing.assert_allclose(found, x, atol=1e-9)


def test_signals_are_those_of_scipy(y) -> None:
    chirp = signal.chirp(TIMES, 0.1, 10, 10, phi=-90)
    np.testing.assert_allclose(y["y.chirp"], chirp, atol=1e-9)
    np.testing.assert_allclose(y["y.sine"], np.sin(2 * np.pi * TIMES), atol=1e-12)
    bits = signal.max_len_seq(9)[0].astype(float) * 2 - 1
    held = bits[np.floor(TIMES / 0.1 + 1e-6).astype(int)]
    np.testing.assert_array_equal(y["y.prbs"], held)
