"""Integration tests of the control loop of the paper; `--system` chooses another one."""

import pytest

from fmu_master import Result
from fmu_master.testing import assert_carries, assert_within

JUMP = 1e-4
"""The set-point of the run [rad]."""

STEP = 0.001
"""The sample time [s]."""

KP, KI, KD = 300.0, 500.0, 100.0
"""The specified gains [N/rad], [N/(rad s)], [N s/rad]."""


def test_the_controller_receives_the_angle_at_once(small_step: Result) -> None:
    assert_carries(small_step, "plant.theta", "controller.y")


def test_the_force_reaches_the_cart_in_the_same_step(small_step: Result) -> None:
    # A row has the outputs of a sampled controller after the step, the inputs of a plant before it.
    assert_carries(small_step, "controller.u", "plant.u", rows=1)


def test_the_gains_are_as_specified(small_step: Result) -> None:
    # The controller of the paper answers one sample late.
    force = small_step["controller.u"][1]
    expected = (KP + KD / STEP + KI * STEP) * JUMP
    message = f"the first force is {force:.6g} N, expected {expected:.6g} N for these gains"
    assert force == pytest.approx(expected, rel=1e-6), message


def test_the_angle_follows_the_set_point(small_step: Result) -> None:
    assert_within(small_step, "plant.theta", -0.01 * JUMP, 1.2 * JUMP)
    assert_within(small_step, "plant.theta", 0.99 * JUMP, 1.01 * JUMP, start=4.0)
