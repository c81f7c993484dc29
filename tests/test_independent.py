"""Closed loops of the FMUs against the independent implementation, sample by sample."""

import csv

import numpy as np
import pytest

import reference
from pendulum_fmus import table1
from side_by_side import assert_close, both

LOOPS = [("Pid", "own"), ("PidRbf", "own"), ("IpidRbf", "own"), ("IpidRbf", "supervisor")]

STEPS = 6000
"""Long enough for the disturbance and the jump of the square wave at 5 s."""

TOLERANCE = 1e-10
"""The two implementations only differ by rounding."""


@pytest.mark.parametrize(
    ("signal", "order"),
    [
        ("step", "sequential"),
        ("sine", "sequential"),
        ("square", "sequential"),
        ("square", "parallel"),
    ],
)
@pytest.mark.parametrize(("controller", "target"), LOOPS)
def test_loop_agrees(fmus, controller, target, signal, order):
    late = None if order == "sequential" else False
    computed, expected = both(
        fmus, controller, signal, 1.0,
        target=target, order=order, previous_sample_terms=late, steps=STEPS,
    )  # fmt: skip
    assert_close(computed, expected, TOLERANCE)


@pytest.mark.parametrize(("controller", "target"), LOOPS[1:])
def test_loop_with_initial_weights_agrees(fmus, controller, target):
    weights = {"w0": (1.0, -2.0, 3.0, -0.5)}
    if target == "supervisor":
        weights["supervisor_w0"] = (-0.1, 0.2, 0.3, 0.4)
    computed, expected = both(fmus, controller, "sine", target=target, steps=2000, **weights)
    assert_close(computed, expected, TOLERANCE)


@pytest.mark.parametrize(("controller", "target"), LOOPS)
def test_loop_agrees_with_non_default_previous_sample_terms(fmus, controller, target):
    late = controller == "IpidRbf"
    computed, expected = both(
        fmus, controller, "square", target=target, previous_sample_terms=late, steps=STEPS
    )
    assert_close(computed, expected, TOLERANCE)


def test_loop_around_the_nonlinear_plant_agrees(fmus):
    computed, expected = both(fmus, "IpidRbf", "step", plant_model="nonlinear", steps=500)
    assert_close(computed, expected, TOLERANCE)


@pytest.mark.parametrize("row", range(6))
def test_the_reference_reproduces_table_1(row):
    with table1.DATA.open(encoding="utf-8") as file:
        numbers = list(csv.DictReader(file))[row]
    excitation = numbers["signal"], float(numbers["disturbance_amplitude"])
    pid = reference.closed_loop("Pid", *excitation)
    pair = reference.closed_loop("IpidRbf", *excitation, target="supervisor")
    assert pid["controller.e"][-1] == pytest.approx(float(numbers["e_pid_expected"]), rel=2e-5)
    assert pair["controller.e"][-1] == pytest.approx(
        float(numbers["e_ipid_rbf_expected"]), rel=2e-5
    )


def test_the_reference_has_the_paper_s_coefficients():
    num, den = reference.difference_equation()
    # (41), without the fourth digits of the zeros: num[2] is a difference of nearly equal numbers
    np.testing.assert_allclose(num[[1, 3]], [1.17824452e-06, -1.17820983e-06], rtol=1e-8)
    np.testing.assert_allclose(den, [1, -2.9999395157378, 2.9998512006421, -0.9999116872136])


def test_the_reference_s_square_wave_is_the_sign_of_the_sine():
    times = reference.TS * np.arange(20001)
    square = [reference.reference("square", t, 0.1) for t in times.tolist()]
    assert square[0] == 0
    np.testing.assert_array_equal(square[1:], np.sign(np.sin(0.2 * np.pi * times[1:])))
