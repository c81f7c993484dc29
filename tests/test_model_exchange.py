"""Model exchange in FMI 2.0 and 3.0: loops, the plant alone, derivatives, time events, states."""

import math
import textwrap
from ctypes import c_double
from pathlib import Path

import fmpy
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import reference
from pendulum_fmus import master, model_exchange
from pendulum_fmus.loop import TS, Loop
from pendulum_fmus.master import MasterError
from pendulum_fmus.model_exchange import Model
from pendulum_fmus.project import ROOT

VERSIONS = {"2.0": "", "3.0": "_fmi3"}
"""The endings of the names of FMUs."""

CONTROLLERS = ["Pid", "PidRbf", "IpidRbf"]
STATES = ["theta", "omega", "x", "v"]
SWING = [2.0, -1.5, 0.3, 0.5]
"""A state far from the upright position: angle [rad], its velocity [rad/s], and those of x."""

pytestmark = pytest.mark.filterwarnings("error")


def file(fmus: Path, model: str, version: str) -> Path:
    """Return the FMU of a model in a version of FMI."""
    return fmus / f"{model}{VERSIONS[version]}.fmu"


def exchanged(loop: Loop, fmus: Path, steps: int, **options) -> dict[str, np.ndarray]:
    """Return the columns of a loop by model exchange, with the set-point 1 rad."""
    inputs = {"controller.r": lambda _: 1.0}
    with loop.system(fmus, Model, without="source") as system:
        return model_exchange.simulate(system, TS, TS, steps, inputs=inputs, **options)


# --- loops --------------------------------------------------------------------------------------


@pytest.mark.parametrize("plant_model", ["linear", "nonlinear"])
@pytest.mark.parametrize("fmi3", [(), ("all",), ("plant",)], ids=["2.0", "3.0", "plant 3.0"])
@pytest.mark.parametrize("controller", CONTROLLERS)
def test_loop_agrees_with_sequential_co_simulation(fmus, controller, fmi3, plant_model):
    start = (("plant.theta0", 0.1),)
    loop = Loop(controller, plant_model=plant_model, overrides=start, fmi3=fmi3)
    columns = exchanged(loop, fmus, 800)
    with loop.system(fmus) as system:
        expected = master.simulate(system, TS, TS, 800, record=[n for n in columns if n != "time"])
    np.testing.assert_array_equal(columns["time"], expected["time"])
    for name, tolerance in {
        "plant.theta": 1e-8,
        "plant.x": 1e-7,
        "controller.e": 1e-8,
        # A tenth of the sample rate times the derivative gain amplifies errors of the angle
        "controller.u": 1e-4,
    }.items():
        np.testing.assert_allclose(columns[name], expected[name], rtol=0, atol=tolerance)
    assert np.ptp(columns["controller.u"]) > 10


@pytest.mark.parametrize("controller", CONTROLLERS)
def test_both_versions_give_the_same_bits(fmus, controller):
    columns = [exchanged(Loop(controller, fmi3=fmi3), fmus, 200) for fmi3 in ((), ("all",))]
    assert columns[0].keys() == columns[1].keys()
    for name, column in columns[0].items():
        np.testing.assert_array_equal(column, columns[1][name])


def test_a_supervised_loop_agrees_with_co_simulation(fmus):
    loop = Loop("IpidRbf", target="supervisor", overrides=(("plant.theta0", 0.1),))
    inputs = {"controller.r": lambda _: 1.0, "supervisor.r": lambda _: 1.0}
    with loop.system(fmus, Model, without="source") as system:
        columns = model_exchange.simulate(system, TS, TS, 300, inputs=inputs)
    with loop.system(fmus) as system:
        expected = master.simulate(system, TS, TS, 300)
    for name in ("plant.theta", "supervisor_plant.theta"):
        np.testing.assert_allclose(columns[name], expected[name], rtol=0, atol=1e-8)


@pytest.mark.parametrize(("step", "steps", "samples"), [(0.0003, 31, 10), (0.0025, 31, 76)])
def test_communication_points_need_not_be_at_events(fmus, step, steps, samples):
    """The state does not depend on when it is looked at."""
    loop = Loop("Pid", overrides=(("plant.theta0", 0.1),))
    with loop.system(fmus, Model, without="source") as system:
        columns = model_exchange.simulate(system, 0.0, step, steps)
    with loop.system(fmus, Model, without="source") as system:
        expected = model_exchange.simulate(system, 0.0, TS, samples)
    assert columns["time"][-1] == pytest.approx(expected["time"][-1])
    for name in ("plant.theta", "controller.e"):
        assert columns[name][-1] == pytest.approx(expected[name][-1], abs=1e-9)


def test_the_example_in_the_docstring_balances_the_pendulum(fmus, monkeypatch):
    monkeypatch.chdir(ROOT)
    example = model_exchange.__doc__.split("states.\n\n")[1].split("\n\nAt an event")[0]
    namespace = dict(vars(model_exchange))
    exec(textwrap.dedent(example), namespace)
    theta = namespace["results"]["plant.theta"]
    assert theta[0] == 0.1
    assert abs(theta[-1]) < 1e-3


def test_continuous_inputs_reach_a_plant_between_events(fmus):
    """Two plants, of which the angle of one is the force on the other, are one linear system."""
    start = {"theta0": 0.1}
    with master.System(
        [
            Model("driven", file(fmus, "Pendulum", "3.0")),
            Model("free", file(fmus, "Pendulum", "2.0"), start),
        ],
        [("free.theta", "driven.u")],
    ) as system:
        columns = model_exchange.simulate(system, 0.0, 0.1, 11)
    A, B = reference.linear_model()
    both = np.block([[A, np.zeros((4, 4))], [np.zeros((4, 4)), A]])
    both[4:, 2] = B
    initial = [0, 0, 0.1, 0, 0, 0, 0, 0]
    exact = solve_ivp(
        lambda _, y: both @ y, (0, 1), initial, method="DOP853", rtol=1e-12, atol=1e-14
    )
    assert columns["free.theta"][-1] == pytest.approx(exact.y[2, -1], rel=1e-8)
    assert columns["driven.theta"][-1] == pytest.approx(exact.y[6, -1], rel=1e-8)


# --- the plant alone ----------------------------------------------------------------------------


@pytest.mark.parametrize("plant_model", ["linear", "nonlinear"])
@pytest.mark.parametrize("version", VERSIONS)
def test_plant_agrees_with_scipy_when_the_force_jumps(fmus, version, plant_model):
    force = [(0.0, 1.0), (0.5, 1.0), (0.5, -4.0), (1.0, -4.0)]
    results = fmpy.simulate_fmu(
        str(file(fmus, "Pendulum", version)),
        fmi_type="ModelExchange",
        solver="CVode",
        stop_time=1.0,
        output_interval=0.1,
        relative_tolerance=1e-10,
        start_values={
            "theta0": 0.2,
            "v0": -0.3,
            "model": {"linear": 2, "nonlinear": 3}[plant_model],
        },
        input=np.array(force, dtype=[("time", float), ("u", float)]),
        output=["x", "v", "theta", "omega"],
    )
    A, B = reference.linear_model()
    derivatives = {"linear": lambda y, u: A @ y + B * u, "nonlinear": reference.derivatives}
    state, exact = [0, -0.3, 0.2, 0], []
    for u in (1.0, -4.0):
        half = solve_ivp(
            lambda _, y, u=u: derivatives[plant_model](y, u), (0, 0.5), state,
            method="DOP853", t_eval=np.linspace(0, 0.5, 6), rtol=1e-12, atol=1e-14,
        )  # fmt: skip
        exact.append(half.y)
        state = half.y[:, -1]
    regular = results[np.searchsorted(results["time"], np.linspace(0, 1, 11) - 1e-9)]
    expected = np.hstack([exact[0], exact[1][:, 1:]])
    for name, column in zip(("x", "v", "theta", "omega"), expected, strict=True):
        np.testing.assert_allclose(regular[name], column, rtol=1e-7, atol=1e-8)


class Plant:
    """The pendulum in the continuous-time mode, by value references."""

    def __init__(self, path: Path, model: str):
        self.model = Model("plant", path, {"model": model, "theta0": 0.1})
        self.model.initialize(0.0)
        self.model.update()
        self.slave = self.model.slave
        self.slave.enterContinuousTimeMode()
        unknowns = [unknown.variable for unknown in self.model.description.derivatives]
        self.order = [unknown.derivative.name for unknown in unknowns]

    def references(self, names) -> list[int]:
        """Return the value references of variables."""
        return [self.model.variable(name).valueReference for name in names]

    def set(self, values) -> None:
        """Set the states STATES and the force."""
        by_name = dict(zip([*STATES, "u"], values, strict=True))
        states = (c_double * 4)(*[by_name[name] for name in self.order])
        self.slave.setContinuousStates(states, 4)
        self.model.set("u", by_name["u"])

    def get(self, names) -> np.ndarray:
        """Return variables by their names."""
        return np.array([self.model.get(name) for name in names])

    def derivatives(self) -> dict[str, float]:
        """Return the derivatives of the states by name."""
        values = (c_double * 4)()
        self.model.fmi.get_derivatives(values, 4)
        return dict(zip(self.order, values, strict=True))


@pytest.fixture
def plant(fmus, version, plant_model):
    """Return a pendulum in the continuous-time mode."""
    plant = Plant(file(fmus, "Pendulum", version), plant_model)
    yield plant
    plant.model.close()


both_plants = pytest.mark.parametrize(
    ("version", "plant_model"), [(v, m) for v in VERSIONS for m in ("linear", "nonlinear")]
)

UNKNOWNS = [f"der({name})" for name in STATES] + STATES


@both_plants
def test_derivatives_are_those_of_the_equations(plant, plant_model):
    plant.set([*SWING, 3.0])
    theta, omega, x, v = SWING
    state = np.array([x, v, theta, omega])
    A, B = reference.linear_model()
    expected = A @ state + B * 3 if plant_model == "linear" else reference.derivatives(state, 3)
    derivatives = plant.derivatives()
    for name, value in zip(("x", "v", "theta", "omega"), expected, strict=True):
        assert derivatives[name] == pytest.approx(value, rel=1e-12)
        assert plant.model.get(f"der({name})") == derivatives[name]
    np.testing.assert_array_equal(plant.get(STATES), SWING)


@both_plants
def test_directional_derivatives_match_central_differences(plant):
    point, step = np.array([*SWING, 3.0]), 1e-4
    unknowns = plant.references(UNKNOWNS)
    for j, name in enumerate([*STATES, "u"]):
        sides = []
        for sign in (1, -1):
            shifted = point.copy()
            shifted[j] += sign * step
            plant.set(shifted)
            sides.append(plant.get(UNKNOWNS))
        difference = (sides[0] - sides[1]) / (2 * step)
        plant.set(point)
        derivative = plant.slave.getDirectionalDerivative(unknowns, plant.references([name]), [1.0])
        np.testing.assert_allclose(derivative, difference, rtol=1e-6, atol=1e-6)


@both_plants
def test_a_directional_derivative_is_a_product_with_the_seed(plant):
    plant.set([*SWING, 3.0])
    unknowns, seed = plant.references(UNKNOWNS), [0.5, -2.0, 1.0, 3.0, 7.0]
    knowns = plant.references([*STATES, "u"])
    derivative = plant.slave.getDirectionalDerivative
    columns = [derivative(unknowns, [known], [1.0]) for known in knowns]
    expected = np.array(columns).T @ seed
    np.testing.assert_allclose(derivative(unknowns, knowns, seed), expected, rtol=1e-13, atol=1e-13)


@both_plants
def test_the_state_of_the_fmu_keeps_the_continuous_states(plant):
    plant.set([*SWING, 3.0])
    expected = plant.get(UNKNOWNS)
    get, put, free = states_of(plant.model)
    state = get()
    plant.set([0.0, 1.0, 2.0, 3.0, 4.0])
    assert not np.array_equal(plant.get(UNKNOWNS), expected)
    put(state)
    np.testing.assert_array_equal(plant.get(UNKNOWNS), expected)
    free(state)


# --- controllers --------------------------------------------------------------------------------


def states_of(model: Model) -> tuple:
    """Return the functions that get, set and free the state of an FMU; 3.0 spells them anew."""
    slave, state = model.slave, "state" if model.description.fmiVersion == "2.0" else "State"
    return tuple(getattr(slave, f"{verb}FMU{state}") for verb in ("get", "set", "free"))


@pytest.fixture
def controller(fmus, version):
    """Return a PidRbf with the sample time 0.01 s in its first event, at t = 0.5 s."""
    start = {"ts": 0.01, "rbf.w0[1]": 2.0, "r": 1.0, "u_max": 1e4}
    with Model("controller", file(fmus, "PidRbf", version), start) as model:
        model.initialize(0.5)
        yield model


def sample(model: Model, y: float) -> float:
    """Go to the next event, take a sample of the angle, and return the force."""
    model.set_time(model.next_event)
    model.slave.enterEventMode()
    model.set("y", y)
    model.update()
    model.slave.enterContinuousTimeMode()
    return model.get("u")


@pytest.mark.parametrize("version", VERSIONS)
def test_samples_are_time_events(controller):
    assert controller.states == 0
    controller.set("y", 0.9)
    controller.update()
    controller.slave.enterContinuousTimeMode()
    first = controller.get("u")
    assert controller.get("e") == 1.0 - 0.9
    for k in range(1, 200):
        assert controller.next_event == pytest.approx(0.5 + k * 0.01, abs=1e-12)
        sample(controller, 0.9)
    assert controller.get("u") > 2 * first  # the network integrates the error


@pytest.mark.parametrize("version", VERSIONS)
def test_nothing_happens_between_samples(controller):
    controller.update()
    controller.slave.enterContinuousTimeMode()
    u = controller.get("u")
    due = controller.next_event
    controller.set_time(0.505)
    controller.slave.enterEventMode()  # of another FMU's making
    controller.set("y", 0.5)
    controller.update()
    controller.slave.enterContinuousTimeMode()
    assert controller.get("u") == u
    assert controller.next_event == due
    assert sample(controller, 0.5) != u


@pytest.mark.parametrize("version", VERSIONS)
def test_the_state_of_the_fmu_can_be_restored_between_samples(controller):
    controller.update()
    controller.slave.enterContinuousTimeMode()
    angles = np.sin(np.arange(20))
    for y in angles[:10]:
        sample(controller, y)
    get, put, free = states_of(controller)
    state, due = get(), controller.next_event
    first = [sample(controller, y) for y in angles[10:]]
    put(state)
    controller.next_event = due
    assert [sample(controller, y) for y in angles[10:]] == first
    free(state)


# --- errors -------------------------------------------------------------------------------------


@pytest.mark.parametrize("version", VERSIONS)
def test_the_transfer_function_is_refused(fmus, version):
    with (
        Model("plant", file(fmus, "Pendulum", version), {"model": "transfer_function"}) as plant,
        pytest.raises(MasterError, match=r"\bmodel\b.*transfer_function"),
    ):
        plant.initialize(0.0)


@pytest.mark.parametrize("version", VERSIONS)
def test_an_fmu_for_co_simulation_only_is_refused(fmus, version):
    with pytest.raises(MasterError, match=r"Source(_fmi3)?\.fmu is not a model-exchange FMU"):
        Model("source", file(fmus, "Source", version))


@pytest.mark.parametrize("version", VERSIONS)
def test_an_error_during_the_integration_names_the_fmu_and_the_time(fmus, version):
    with master.System([Model("plant", file(fmus, "Pendulum", version))], []) as system:
        force = {"plant.u": lambda t: 1.0 if t < 0.5 else math.nan}
        with pytest.raises(MasterError, match=r"plant \(Pendulum\S*\), u = nan at t = 0\.\d+ s"):
            model_exchange.simulate(system, 0.0, 0.1, 11, inputs=force)
