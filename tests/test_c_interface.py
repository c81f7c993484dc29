"""The C interface of each model's binary.

Tested are the completeness of the saved state, the report of a diverging variable, and the
derivatives of the pendulum. What all models share is in `crates/fmu-export/tests/c_interface`.
"""

import math
import multiprocessing
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.signal import lfilter

import reference
from pendulum_fmus.master import Component, MasterError, Reals

MODELS = ["Pendulum", "Pid", "PidRbf", "IpidRbf", "Source"]

H = 0.001


def snapshot(component: Component) -> bytes:
    """Return the FMU state as bytes."""
    slave = component.slave
    state = slave.getFMUstate()
    serialized = slave.serializeFMUstate(state)
    slave.freeFMUstate(state)
    return serialized


def resume(component: Component, serialized: bytes) -> None:
    """Restore the state from the bytes."""
    slave = component.slave
    state = slave.deSerializeFMUstate(serialized)
    slave.setFMUstate(state)
    slave.freeFMUstate(state)


# --- the layer, in a binary ---------------------------------------------------------------------


def test_the_library_is_unloaded_after_use(fmus):
    def is_mapped() -> bool:
        return library in Path("/proc/self/maps").read_text()

    for _ in range(3):
        with Component("plant", fmus / "Pendulum.fmu") as component:
            library = component.slave.dll._name
            component.initialize(0.0)
            component.step(0.0, H)
            assert is_mapped()
        assert not is_mapped()


# --- model-specific behaviour -------------------------------------------------------------------

# A controller's weights change, and every form of the plant has its own state.
MOVING = [
    ("Pendulum", {"theta0": 0.3, "omega0": -0.5, "model": "transfer_function"}),
    ("Pendulum", {"theta0": 0.3, "omega0": -0.5, "model": "linear"}),
    ("Pendulum", {"theta0": 0.3, "omega0": -0.5, "model": "nonlinear"}),
    ("Pid", {"previous_sample_terms": True, "ts": 0.0025}),
    ("PidRbf", {"rbf.eta": 0.7, "rbf.w0[2]": 1.5}),
    ("IpidRbf", {"rbf.target": "supervisor", "rbf.alpha": 0.5}),
    ("Source", {"signal": "sine", "disturbance.amplitude": 1.0, "disturbance.start": 0.02}),
]


def drive(component: Component, first: int) -> list[list[str]]:
    """Take 20 steps with changing inputs; return all Reals after each, bit for bit."""
    variables = component.variables.values()
    inputs = Reals(component, [v.name for v in variables if v.causality == "input"])
    everything = Reals(component, [v.name for v in variables if v.type == "Real"])
    trace = []
    for k in range(first, first + 20):
        inputs.values[:] = [0.1 * (k % 7 - j) for j in range(inputs.count)]
        inputs.set()
        component.step(k * H, H)
        everything.get()
        trace.append([value.hex() for value in everything.values])
    return trace


def drive_on(path: Path, serialized: bytes) -> list[list[str]]:
    """Continue from a state in a new instance."""
    with Component("later", path) as component:
        resume(component, serialized)
        return drive(component, 20)


@pytest.fixture(scope="module")
def other_process() -> Iterator[ProcessPoolExecutor]:
    """Return another process that runs this Python."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        yield pool


@pytest.mark.parametrize(("model", "start"), MOVING)
def test_a_state_continues_bit_for_bit_in_another_process(
    fmus, instance, other_process, model, start
):
    component = instance(model, start)
    before = drive(component, 0)
    serialized = snapshot(component)
    expected = drive(component, 20)
    assert expected[-1] != before[-1], "it moves"
    later = other_process.submit(drive_on, fmus / f"{model}.fmu", serialized)
    assert later.result() == expected


@pytest.mark.parametrize("model", MODELS)
def test_start_values_and_bounds_match_the_model_description(fmus, model):
    with Component("fresh", fmus / f"{model}.fmu") as component:
        before = snapshot(component)
        settable = [v for v in component.variables.values() if v.start is not None]
        for variable in settable:
            component.set(variable.name, variable.start)
        assert snapshot(component) == before
        for variable in (v for v in settable if v.type == "Real"):
            for bound, beyond in ((variable.min, -math.inf), (variable.max, math.inf)):
                if bound is not None:
                    component.set(variable.name, bound)
                    with pytest.raises(MasterError, match=r"status 3.* is refused"):
                        component.set(variable.name, math.nextafter(float(bound), beyond))


DIVERGES = [
    ("Pendulum", {"theta0": 0.1}, {}, 1e300, "(theta|omega|x|v) became (NaN|-?inf)"),
    ("Pendulum", {"model": "nonlinear"}, {"u": 1e200}, H, "u = 1e200 N"),
    ("Pid", {}, {"r": 1.7e308}, H, "(e|u_p|u) became inf"),
    ("PidRbf", {"rbf.eta": 10.0}, {"r": 1.0}, 0.5, r"(rbf\.w\[\d\]|u|u_p|u_n) became (NaN|-?inf)"),
    ("IpidRbf", {"rbf.eta": 10.0}, {"r": 1.0}, 0.5, r"(rbf\.w\[\d\]|u|u_p|u_n) became (NaN|-?inf)"),
    ("Source", {"signal": "sine", "frequency": 1e6}, {}, 1e303, "r became NaN"),
]
"""Parameters, inputs, a step [s] that overflows, and the expected message."""


@pytest.mark.parametrize(("model", "parameters", "inputs", "step", "reason"), DIVERGES)
def test_divergence_is_reported_and_a_reset_recovers(
    instance, model, parameters, inputs, step, reason
):
    component = instance(model, parameters)
    component.step(0.0, H)
    for name, value in inputs.items():
        component.set(name, value)
    with pytest.raises(MasterError, match=rf"status 3: .*from t = 0.001 s .*{reason}"):
        component.step(H, step)
    component.slave.reset()
    component.initialize(0.0)
    component.step(0.0, H)


def test_a_start_time_without_a_set_point_is_rejected(fmus):
    with Component("source", fmus / "Source.fmu", {"signal": "sine", "frequency": 1e6}) as source:
        with pytest.raises(MasterError, match=r"status 3: .*\br became NaN"):
            source.initialize(1e304)
        source.slave.reset()
        source.initialize(0.0)


@pytest.mark.parametrize("model", ["Pendulum", "Pid", "PidRbf", "IpidRbf"])
def test_a_step_of_too_many_samples_is_discarded_and_changes_nothing(instance, model):
    form = {"model": "transfer_function"} if model == "Pendulum" else {}
    component = instance(model, {"ts": 1e-6, **form})
    component.step(0.0, H)
    before = snapshot(component)
    with pytest.raises(MasterError, match=r"status 2: .*sample"):
        component.step(H, 1000.0)
    resume(component, before)
    component.step(H, H)


# --- derivatives of the pendulum ----------------------------------------------------------------

STATE = ("x", "v", "theta", "omega")
"""The outputs in the order of the reference's state."""

INITIAL = (0.3, -0.2, 0.1, 0.5)


def pendulum(instance, form: str) -> Component:
    """Return a pendulum before its first step."""
    start = dict(zip(("x0", "v0", "theta0", "omega0"), INITIAL, strict=True))
    return instance("Pendulum", {"model": form, **start})


def state(plant: Component) -> np.ndarray:
    """Return (x, v, theta, omega) in SI units."""
    return np.array([plant.get(name) for name in STATE])


@pytest.mark.parametrize("form", ["transfer_function", "linear", "nonlinear"])
def test_the_directional_derivative_is_the_difference_quotient_of_the_step(instance, form):
    plant, delta, ends = pendulum(instance, form), 0.01, []
    unknowns = [plant.variable(name).valueReference for name in STATE]
    known = [plant.variable("u").valueReference]
    assert plant.slave.getDirectionalDerivative(unknowns, known, [1.0]) == [0, 0, 0, 0]
    plant.step(0.0, 0.1)
    start = snapshot(plant)
    for force in (3.0 + delta, 3.0 - delta, 3.0):
        resume(plant, start)
        plant.set("u", force)
        plant.step(0.1, 0.1)
        ends.append(state(plant))
    derivative = plant.slave.getDirectionalDerivative(unknowns, known, [1.0])
    expected = (ends[0] - ends[1]) / (2 * delta)
    np.testing.assert_allclose(derivative, expected, rtol=2e-6, atol=1e-9 * np.max(abs(expected)))
    assert np.any(expected)


def ramp(plant: Component, slope: float) -> None:
    """Set the derivative of u [N/s]."""
    plant.slave.setRealInputDerivatives([plant.variable("u").valueReference], [1], [slope])


def linear_response(initial: np.ndarray, u: float, slope: float, step: float) -> np.ndarray:
    """Return the state after `step` [s] of u + slope t: the matrix exponential of (y, u, u')."""
    A, B = reference.linear_model()
    augmented = np.zeros((6, 6))
    augmented[:4, :4], augmented[:4, 4], augmented[4, 5] = A, B, 1
    return (expm(augmented * step) @ [*initial, u, slope])[:4]


def nonlinear_response(initial: np.ndarray, u: float, slope: float, step: float) -> np.ndarray:
    """Return the state after `step` [s] of u + slope t on the nonlinear model."""
    solution = solve_ivp(
        lambda t, y: reference.derivatives(y, u + slope * t), (0, step), initial,
        method="DOP853", rtol=1e-12, atol=1e-14,
    )  # fmt: skip
    return solution.y[:, -1]


@pytest.mark.parametrize(
    ("form", "respond"), [("linear", linear_response), ("nonlinear", nonlinear_response)]
)
def test_a_chain_of_ramps_follows_a_polygon_and_ends_in_a_constant_force(
    instance, form: str, respond: Callable
):
    plant, expected = pendulum(instance, form), np.array(INITIAL)
    forces, step = [0.0, 3.0, -2.0, 8.0, 8.0], 0.1
    for k, (u, after) in enumerate(pairwise(forces)):
        plant.set("u", u)
        if u != after:
            ramp(plant, (after - u) / step)
        plant.step(k * step, step)
        expected = respond(expected, u, (after - u) / step, step)
        np.testing.assert_allclose(state(plant), expected, rtol=1e-7, atol=1e-10)


def test_the_transfer_function_samples_the_ramp(instance):
    """(41) holds the force over a sample, so it takes u + u' t at the sample instants."""
    plant = instance("Pendulum", {"model": "transfer_function"})
    plant.set("u", 2.0)
    samples, slope = 50, 40.0
    ramp(plant, slope)
    plant.step(0.0, samples * reference.TS)
    forces = 2.0 + slope * reference.TS * np.arange(samples)
    expected = lfilter(*reference.difference_equation(), [*forces, 0.0])[-1]
    assert plant.get("theta") == pytest.approx(expected, rel=1e-6)
