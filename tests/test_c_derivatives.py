"""Directional derivatives and input derivatives of the pendulum, and their absence elsewhere."""

import math
from collections.abc import Sequence
from ctypes import c_uint
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.signal import lfilter

import reference
from slave import (
    ERROR,
    MODELS,
    OK,
    Slave,
    each_model,
    integers,
    isolated,
    reals,
    references,
    unpack,
)

TRANSFER_FUNCTION, LINEAR, NONLINEAR = 1, 2, 3

STATE = ("x", "v", "theta", "omega")
"""The outputs in the order of the reference's state."""

H = 0.01

STARTS = {
    "upright": (0.0, 0.0, 0.0, 0.0),
    "leaning": (0.3, -0.2, 0.1, 0.5),
    "sideways": (0.0, 0.0, 1.5, 0.0),
    "spinning": (1.0, -3.0, 0.5, 12.0),
    "hanging": (0.0, 1.0, 3.0, -2.0),
}
"""Initial states (x, v, theta, omega)."""


def pendulum(fmus, form: int, initial: Sequence[float] = STARTS["leaning"], **start) -> Slave:
    """Return a pendulum in initialization mode."""
    slave = Slave(unpack(fmus, "Pendulum")).put(model=form, **start)
    slave.put(**{f"{name}0": value for name, value in zip(STATE, initial, strict=True)})
    assert slave.fmi2SetupExperiment(0, 0.0, 0.0, 0, 0.0) == OK
    assert slave.fmi2EnterInitializationMode() == OK
    return slave


def running(fmus, form: int, initial: Sequence[float] = STARTS["leaning"], **start) -> Slave:
    """Return a pendulum that is ready for its first step."""
    slave = pendulum(fmus, form, initial, **start)
    assert slave.fmi2ExitInitializationMode() == OK
    return slave


def state(slave: Slave) -> np.ndarray:
    """Return (x, v, theta, omega) in SI units."""
    return np.array(slave.get_all(slave.fmu.variables[name] for name in STATE))


def derivative(slave: Slave, names: Sequence[str] = STATE, seed: float = 1.0) -> np.ndarray:
    """Return the directional derivative of outputs by u, times the seed."""
    unknowns = [slave.fmu.variables[name] for name in names]
    result = reals(*[math.nan] * len(names))
    status = slave.fmi2GetDirectionalDerivative(
        references(unknowns), len(names),
        references([slave.fmu.variables["u"]]), 1, reals(seed), result,
    )  # fmt: skip
    assert status == OK, slave.told
    return np.array(result)


def difference(slave: Slave, start, time: float, step: float, u: float, delta: float) -> np.ndarray:
    """Return the central difference quotient of the step from the FMU state `start`, by u."""
    ends = []
    for force in (u + delta, u - delta):
        assert slave.fmi2SetFMUstate(start) == OK
        assert slave.put(u=force).step(time, step) == OK
        ends.append(state(slave))
    return (ends[0] - ends[1]) / (2 * delta)


# --- directional derivatives --------------------------------------------------------------------


@pytest.mark.parametrize("initial", STARTS)
@pytest.mark.parametrize("form", [TRANSFER_FUNCTION, LINEAR, NONLINEAR])
@pytest.mark.parametrize("step", [0.001, 0.01, 0.3])
@isolated
def test_derivative_is_the_difference_quotient_of_the_step(fmus, form, initial, step):
    slave = running(fmus, form, STARTS[initial]).put(u=3.0)
    assert slave.step(0.0, step) == OK
    start = slave.save()
    assert slave.put(u=-4.0).step(step, step) == OK
    computed = derivative(slave)
    # The linear forms have no higher terms; the error of the nonlinear one is of order delta².
    delta = 0.01 if form == NONLINEAR else 10.0
    expected = difference(slave, start, step, step, -4.0, delta)
    np.testing.assert_allclose(computed, expected, rtol=2e-6, atol=1e-9 * np.max(abs(expected)))
    assert np.any(computed != 0)


@pytest.mark.parametrize("step", [0.001, 0.01, 1.0])
@isolated
def test_linear_derivative_is_the_input_matrix_of_the_hold(fmus, step):
    slave = running(fmus, LINEAR).put(u=2.0)
    assert slave.step(0.0, step) == OK
    np.testing.assert_allclose(derivative(slave), reference.hold(step)[1], rtol=1e-9)


@pytest.mark.parametrize("initial", STARTS)
@pytest.mark.parametrize("step", [0.001, 0.1, 0.5])
@isolated
def test_nonlinear_derivative_solves_the_sensitivity_equation(fmus, initial, step):
    u = 5.0
    slave = running(fmus, NONLINEAR, STARTS[initial]).put(u=u)
    assert slave.step(0.0, step) == OK
    np.testing.assert_allclose(
        derivative(slave), sensitivity(STARTS[initial], u, step), rtol=1e-6, atol=1e-12
    )


def sensitivity(initial: Sequence[float], u: float, step: float) -> np.ndarray:
    """Integrate s' = (df/dy) s + df/du along the motion by SciPy, from s = 0.

    The slopes by state and force are central differences of the right side.
    """

    def slope(_, both):
        y, s = both[:4], both[4:]
        delta = 1e-6
        by_state = [
            (reference.derivatives(y + e, u) - reference.derivatives(y - e, u)) / (2 * delta)
            for e in delta * np.eye(4)
        ]
        by_force = (reference.derivatives(y, u + 1) - reference.derivatives(y, u - 1)) / 2
        return np.concatenate([reference.derivatives(y, u), np.transpose(by_state) @ s + by_force])

    start = np.concatenate([initial, np.zeros(4)])
    solution = solve_ivp(slope, (0, step), start, method="DOP853", rtol=1e-10, atol=1e-13)
    return solution.y[4:, -1]


@pytest.mark.parametrize("samples", [1, 2, 25])
@isolated
def test_transfer_function_s_derivative_is_the_sum_of_its_impulse_response(fmus, samples):
    slave = running(fmus, TRANSFER_FUNCTION).put(u=2.0)
    assert slave.step(0.0, samples * reference.TS) == OK
    response = lfilter(*reference.difference_equation(), [1.0] * samples + [0.0])[-1]
    np.testing.assert_allclose(derivative(slave), [0, 0, response, 0], rtol=1e-6)


@pytest.mark.parametrize("form", [TRANSFER_FUNCTION, LINEAR, NONLINEAR])
@isolated
def test_before_the_first_step_nothing_depends_on_the_force(fmus, form):
    slave = pendulum(fmus, form).put(u=3.0)
    np.testing.assert_array_equal(derivative(slave), np.zeros(4))
    assert slave.fmi2ExitInitializationMode() == OK
    np.testing.assert_array_equal(derivative(slave), np.zeros(4))
    assert slave.step(0.0, H) == OK
    assert np.any(derivative(slave) != 0)
    assert slave.fmi2Reset() == OK
    slave.start()
    np.testing.assert_array_equal(derivative(slave), np.zeros(4))


@pytest.mark.parametrize("form", [TRANSFER_FUNCTION, LINEAR, NONLINEAR])
@isolated
def test_derivative_is_that_of_the_last_step_whatever_is_set_since(fmus, form):
    slave = running(fmus, form).put(u=3.0)
    assert slave.step(0.0, H) == OK
    expected = derivative(slave)
    slave.put(u=-77.0)
    np.testing.assert_array_equal(derivative(slave), expected)
    assert slave.step(H, 0.0) == OK
    np.testing.assert_array_equal(derivative(slave), expected)
    saved = slave.save()
    assert slave.step(H, 3 * H) == OK
    assert np.any(derivative(slave) != expected)
    assert slave.fmi2SetFMUstate(saved) == OK
    np.testing.assert_array_equal(derivative(slave), expected)
    assert slave.fmi2Terminate() == OK
    np.testing.assert_array_equal(derivative(slave), expected)


@pytest.mark.parametrize("form", [LINEAR, NONLINEAR])
@isolated
def test_asking_for_derivatives_changes_nothing(fmus, form):
    slave = running(fmus, form).put(u=3.0)
    assert slave.step(0.0, H) == OK
    before = slave.snapshot()
    derivative(slave)
    assert slave.snapshot() == before


@isolated
def test_seeds_scale_and_several_of_them_add_up(fmus):
    slave = running(fmus, LINEAR).put(u=3.0)
    assert slave.step(0.0, H) == OK
    single = derivative(slave)
    np.testing.assert_allclose(derivative(slave, seed=-2.5), -2.5 * single, rtol=1e-14)
    np.testing.assert_array_equal(derivative(slave, seed=0.0), np.zeros(4))
    order = ["theta", "x", "theta"]
    np.testing.assert_array_equal(derivative(slave, order), single[[2, 0, 2]])
    u, x = (slave.fmu.variables[name] for name in ("u", "x"))
    result = reals(math.nan)
    status = slave.fmi2GetDirectionalDerivative(
        references([x]), 1, references([u, u]), 2, reals(2.0, 3.0), result
    )
    assert status == OK
    assert result[0] == pytest.approx(5 * single[0], rel=1e-14)


@isolated
def test_none_of_the_unknowns_or_of_the_knowns_is_fine(fmus):
    slave = running(fmus, LINEAR).put(u=3.0)
    assert slave.step(0.0, H) == OK
    u, x = (references([slave.fmu.variables[name]]) for name in ("u", "x"))
    call = slave.fmi2GetDirectionalDerivative
    assert call(None, 0, u, 1, reals(1.0), None) == OK
    assert call(None, 0, None, 0, None, None) == OK
    result = reals(math.nan)
    assert call(x, 1, None, 0, None, result) == OK
    assert result[0] == 0


@pytest.mark.parametrize(
    ("unknown", "known"),
    [("u", "u"), ("M", "u"), ("x", "x"), ("x", "M"), ("x", "model"), ("model", "u")],
)
@isolated
def test_derivatives_are_those_of_outputs_by_inputs_only(fmus, unknown, known):
    slave = running(fmus, LINEAR)
    assert slave.step(0.0, H) == OK
    pair = [references([slave.fmu.variables[name]]) for name in (unknown, known)]
    result = reals(7.0)
    assert slave.fmi2GetDirectionalDerivative(pair[0], 1, pair[1], 1, reals(1.0), result) == ERROR
    assert "fmi2GetDirectionalDerivative" in slave.told
    assert result[0] == 7


@isolated
def test_derivatives_refuse_what_is_unknown_null_or_no_number(fmus):
    slave = running(fmus, LINEAR)
    assert slave.step(0.0, H) == OK
    u, x = (references([slave.fmu.variables[name]]) for name in ("u", "x"))
    nobody, seed, result = (c_uint * 1)(999), reals(1.0), reals(7.0)
    call = slave.fmi2GetDirectionalDerivative
    for arguments in [
        (nobody, 1, u, 1, seed, result), (x, 1, nobody, 1, seed, result),
        (None, 1, u, 1, seed, result), (x, 1, None, 1, seed, result),
        (x, 1, u, 1, None, result), (x, 1, u, 1, seed, None),
        (x, 1, u, 1, reals(math.nan), result), (x, 1, u, 1, reals(math.inf), result),
    ]:  # fmt: skip
        logged = len(slave.messages)
        assert call(*arguments) == ERROR, [a[0] if hasattr(a, "__len__") else a for a in arguments]
        assert len(slave.messages) == logged + 1
    assert result[0] == 7


# --- input derivatives --------------------------------------------------------------------------


def ramp(slave: Slave, slope: float, order: int = 1) -> int:
    """Set the derivative of u [N/s]."""
    u = references([slave.fmu.variables["u"]])
    return slave.fmi2SetRealInputDerivatives(u, 1, integers(order), reals(slope))


def linear_ramp_response(
    initial: Sequence[float], u: float, slope: float, step: float
) -> np.ndarray:
    """Return the state after `step` [s] of u + slope t: the matrix exponential of (y, u, u')."""
    A, B = reference.linear_model()
    augmented = np.zeros((6, 6))
    augmented[:4, :4], augmented[:4, 4], augmented[4, 5] = A, B, 1
    return (expm(augmented * step) @ [*initial, u, slope])[:4]


def nonlinear_ramp_response(
    initial: Sequence[float], u: float, slope: float, step: float
) -> np.ndarray:
    """Return the state after `step` [s] of u + slope t on the nonlinear model."""
    solution = solve_ivp(
        lambda t, y: reference.derivatives(y, u + slope * t), (0, step), initial,
        method="DOP853", rtol=1e-12, atol=1e-14,
    )  # fmt: skip
    return solution.y[:, -1]


RESPONSES = {LINEAR: linear_ramp_response, NONLINEAR: nonlinear_ramp_response}


@pytest.mark.parametrize("form", RESPONSES)
@pytest.mark.parametrize("step", [0.001, 0.05, 0.5])
@pytest.mark.parametrize("initial", STARTS)
@isolated
def test_force_is_of_first_order_over_the_next_step_and_constant_again(fmus, form, step, initial):
    slave, respond = running(fmus, form, STARTS[initial]).put(u=2.0), RESPONSES[form]
    assert ramp(slave, 40.0) == OK
    assert slave.step(0.0, step) == OK
    expected = respond(STARTS[initial], 2.0, 40.0, step)
    np.testing.assert_allclose(state(slave), expected, rtol=1e-8, atol=1e-11)
    held = respond(STARTS[initial], 2.0, 0.0, step)
    assert np.max(abs(expected - held)) > 1e-7, "the slope counts"
    assert slave.step(step, step) == OK
    expected = respond(expected, 2.0, 0.0, step)
    np.testing.assert_allclose(state(slave), expected, rtol=1e-7, atol=1e-10)


@pytest.mark.parametrize("form", RESPONSES)
@isolated
def test_a_chain_of_ramps_follows_a_polygon(fmus, form):
    slave, expected = running(fmus, form), np.array(STARTS["leaning"])
    forces = [0.0, 3.0, -2.0, -2.0, 8.0]
    for k, (u, after) in enumerate(pairwise(forces)):
        slave.put(u=u)
        assert ramp(slave, (after - u) / H) == OK
        assert slave.step(k * H, H) == OK
        expected = RESPONSES[form](expected, u, (after - u) / H, H)
        np.testing.assert_allclose(state(slave), expected, rtol=1e-8, atol=1e-11)


@isolated
def test_the_transfer_function_samples_the_ramp(fmus):
    """(41) holds the force over a sample, so it takes u + u' t at the sample instants."""
    slave = running(fmus, TRANSFER_FUNCTION, STARTS["upright"]).put(u=2.0)
    samples, slope = 50, 40.0
    assert ramp(slave, slope) == OK
    assert slave.step(0.0, samples * reference.TS) == OK
    forces = 2.0 + slope * reference.TS * np.arange(samples)
    expected = lfilter(*reference.difference_equation(), [*forces, 0.0])[-1]
    assert slave.get("theta") == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("phase", ["instantiated", "initialization"])
@pytest.mark.parametrize("form", RESPONSES)
@isolated
def test_a_ramp_set_before_the_first_step_is_that_of_the_first_step(fmus, phase, form):
    slave = pendulum(fmus, form)
    if phase == "instantiated":
        slave = Slave(slave.fmu).put(model=form, x0=0.3, v0=-0.2, theta0=0.1, omega0=0.5)
        assert ramp(slave.put(u=2.0), 40.0) == OK
        slave.start()
    else:
        assert ramp(slave.put(u=2.0), 40.0) == OK
        assert slave.fmi2ExitInitializationMode() == OK
    assert slave.step(0.0, H) == OK
    expected = RESPONSES[form](STARTS["leaning"], 2.0, 40.0, H)
    np.testing.assert_allclose(state(slave), expected, rtol=1e-8, atol=1e-11)


@pytest.mark.parametrize("form", RESPONSES)
@isolated
def test_neither_zero_steps_nor_refused_ones_use_the_ramp_up(fmus, form):
    slave = running(fmus, form).put(u=2.0)
    assert ramp(slave, 40.0) == OK
    assert slave.step(0.0, 0.0) == OK
    assert slave.step(0.0, -H) == ERROR
    assert slave.step(0.0, H) == OK
    expected = RESPONSES[form](STARTS["leaning"], 2.0, 40.0, H)
    np.testing.assert_allclose(state(slave), expected, rtol=1e-8, atol=1e-11)


@pytest.mark.parametrize("form", RESPONSES)
@isolated
def test_an_fmu_state_holds_the_ramp(fmus, form):
    slave = running(fmus, form).put(u=2.0)
    assert ramp(slave, 40.0) == OK
    serialized = slave.snapshot()
    assert slave.step(0.0, H) == OK
    expected = slave.everything()
    assert slave.resume(serialized).step(0.0, H) == OK
    assert slave.everything() == expected
    assert Slave(slave.fmu).resume(serialized).step(0.0, H) == OK


@isolated
def test_a_reset_forgets_the_ramp(fmus):
    slave = running(fmus, LINEAR)
    assert ramp(slave, 40.0) == OK
    assert slave.fmi2Reset() == OK
    assert slave.start().step(0.0, H) == OK
    np.testing.assert_array_equal(state(slave), np.zeros(4))


@pytest.mark.parametrize("form", [LINEAR, NONLINEAR])
@isolated
def test_derivative_under_a_ramp_is_by_the_force_at_its_beginning(fmus, form):
    slave = running(fmus, form)
    start = slave.save()
    ends, computed = [], None
    for u in (2.0, 2.01, 1.99):
        assert slave.fmi2SetFMUstate(start) == OK
        assert ramp(slave.put(u=u), 40.0) == OK
        assert slave.step(0.0, 0.1) == OK
        computed = derivative(slave) if computed is None else computed
        ends.append(state(slave))
    np.testing.assert_allclose(computed, (ends[1] - ends[2]) / 0.02, rtol=1e-5, atol=1e-10)


@pytest.mark.parametrize("order", [0, 2, 3, -1, 2**31 - 1])
@isolated
def test_only_the_first_derivative_of_the_force_is_taken(fmus, order):
    slave = running(fmus, LINEAR)
    before = slave.snapshot()
    assert ramp(slave, 40.0, order) == ERROR
    assert "fmi2SetRealInputDerivatives" in slave.told
    assert slave.snapshot() == before


@pytest.mark.parametrize("slope", [math.nan, math.inf, -math.inf])
@isolated
def test_a_slope_that_is_no_number_is_refused(fmus, slope):
    slave = running(fmus, LINEAR)
    before = slave.snapshot()
    assert ramp(slave, slope) == ERROR
    assert "u" in slave.told.split()
    assert slave.snapshot() == before


@pytest.mark.parametrize("name", ["theta", "M", "model"])
@isolated
def test_only_inputs_have_input_derivatives(fmus, name):
    slave = running(fmus, LINEAR)
    before = slave.snapshot()
    some = references([slave.fmu.variables["u"], slave.fmu.variables[name]])
    assert slave.fmi2SetRealInputDerivatives(some, 2, integers(1, 1), reals(1.0, 1.0)) == ERROR
    assert name in slave.told
    assert slave.snapshot() == before


@isolated
def test_input_derivatives_refuse_null_unless_nothing_is_set(fmus):
    slave = running(fmus, LINEAR)
    u = references([slave.fmu.variables["u"]])
    call, before = slave.fmi2SetRealInputDerivatives, slave.snapshot()
    assert call(None, 1, integers(1), reals(1.0)) == ERROR
    assert call(u, 1, None, reals(1.0)) == ERROR
    assert call(u, 1, integers(1), None) == ERROR
    assert slave.snapshot() == before
    assert call(None, 0, None, None) == OK


# --- what the flags say -------------------------------------------------------------------------


@each_model
@isolated
def test_flags_say_who_has_derivatives(fmus, model):
    fmu = unpack(fmus, model)
    assert fmu.flag("providesDirectionalDerivative") == (model == "Pendulum")
    assert fmu.flag("canInterpolateInputs") == (model == "Pendulum")
    assert int(fmu.flags.get("maxOutputDerivativeOrder", 0)) == 0
    assert fmu.flag("canGetAndSetFMUstate")
    assert fmu.flag("canSerializeFMUstate")


@pytest.mark.parametrize("model", [model for model in MODELS if model != "Pendulum"])
@isolated
def test_the_others_refuse_derivatives_and_say_so(fmus, model):
    slave = Slave(unpack(fmus, model)).start()
    assert slave.step(0.0, H) == OK
    outputs, inputs = slave.fmu.of("Real", "output")[:1], slave.fmu.of("Real", "input")[:1]
    some, known = references(outputs), references(inputs or outputs)
    call = slave.fmi2GetDirectionalDerivative
    assert call(some, 1, known, 1, reals(1.0), reals(0.0)) == ERROR
    assert "fmi2GetDirectionalDerivative" in slave.told
    assert slave.fmi2SetRealInputDerivatives(known, 1, integers(1), reals(1.0)) == ERROR
    assert "fmi2SetRealInputDerivatives" in slave.told
    assert slave.fmi2GetRealOutputDerivatives(some, 1, integers(1), reals(0.0)) == ERROR
    assert "fmi2GetRealOutputDerivatives" in slave.told
