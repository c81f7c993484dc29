"""Model exchange in FMI 2.0 and 3.0: loops, the plant alone, derivatives, time events, states."""

import math
from collections.abc import Callable, Iterator, Mapping
from ctypes import byref, c_double, sizeof
from functools import partial
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.sundials import CVodeSolver
from scipy.integrate import solve_ivp

import reference
from pendulum_fmus import master
from pendulum_fmus.fmi import Component, MasterError, Reals
from pendulum_fmus.loop import TS, Loop
from pendulum_fmus.master import System

VERSIONS = {"2.0": "", "3.0": "_fmi3"}
"""The endings of the names of FMUs."""

CONTROLLERS = ["Pid", "PidRbf", "IpidRbf"]
STATES = ["theta", "omega", "x", "v"]
SWING = [2.0, -1.5, 0.3, 0.5]
"""A state far from the upright position: angle [rad], its velocity [rad/s], and those of x."""

pytestmark = pytest.mark.filterwarnings("error")


@pytest.fixture(params=VERSIONS)
def file(fmus: Path, request) -> Callable[[str], Path]:
    """Return a function that names the FMU of a model, in each version of FMI."""
    return lambda model: fmus / f"{model}{VERSIONS[request.param]}.fmu"


# --- a master by model exchange -----------------------------------------------------------------


class Model(Component):
    """An instance for model exchange; it is in its event mode after the initialization."""

    KIND, CLASS = "modelExchange", "Model"

    def set_time(self, time: float) -> None:
        """Set the time [s]."""
        self.time = time
        self.slave.setTime(time)

    def update(self) -> None:
        """Update the discrete states, and enter the continuous-time mode."""
        fmi2 = self.description.fmiVersion == "2.0"
        update = self.slave.newDiscreteStates if fmi2 else self.slave.updateDiscreteStates
        needed, _, _, _, defined, time = update()
        assert not needed
        self.next_event = time if defined else math.inf
        assert self.next_event > self.time
        self.slave.enterContinuousTimeMode()

    def derivatives(self, values) -> None:
        """Read the derivatives of the continuous states."""
        fmi2 = self.description.fmiVersion == "2.0"
        get = self.slave.getDerivatives if fmi2 else self.slave.getContinuousStateDerivatives
        get(values, self.states)

    @property
    def states(self) -> int:
        """The number of continuous states."""
        return self.description.numberOfContinuousStates


class Exchange:
    """Models whose states CVode integrates together, with inputs that are functions of time."""

    def __init__(self, system: System, start: float, inputs: Mapping[str, Callable]):
        self.models: list[Model] = list(system.components.values())
        self.time = start
        self.feeds: dict[str, list] = {model.name: [] for model in self.models}
        for output, input_ in system.connections:
            (source, variable), (fed, name) = system.locate(output), system.locate(input_)
            self.feeds[fed.name].append((Reals(fed, [name]), Reals(source, [variable])))
        for input_, function in inputs.items():
            fed, name = system.locate(input_)
            self.feeds[fed.name].append((Reals(fed, [name]), function))
        for model in self.models:
            model.initialize(start)
        self._update()
        ends = np.cumsum([0, *(model.states for model in self.models)]).tolist()
        offsets = [sizeof(c_double) * end for end in ends]
        self.parts = [p for p in zip(self.models, offsets, strict=False) if p[0].states]
        self.solver = CVodeSolver(
            nx=ends[-1], nz=0, get_z=None, input=None, startTime=start, relativeTolerance=1e-12,
            get_x=partial(self._each, "getContinuousStates"),
            set_x=partial(self._each, "setContinuousStates"),
            get_nominals=partial(self._each, "getNominalsOfContinuousStates"),
            get_dx=self._derivatives, set_time=self._set_time,
        )  # fmt: skip

    def _each(self, function: str, values, _count: int) -> None:
        for model, offset in self.parts:
            getattr(model.slave, function)(byref(values.contents, offset), model.states)

    def _set_time(self, time: float) -> None:
        for model, _ in self.parts:
            model.set_time(time)

    def _derivatives(self, values, _count: int) -> None:
        for model, _ in self.parts:
            self._feed(model)
        for model, offset in self.parts:
            model.derivatives(byref(values.contents, offset))

    def _feed(self, model: Model) -> None:
        for reals, source in self.feeds[model.name]:
            if isinstance(source, Reals):
                source.get()
            reals.values[0] = source.values[0] if isinstance(source, Reals) else source(model.time)
            reals.set()

    def _update(self) -> None:
        """Let one model after another fetch its inputs and handle an event."""
        for model in self.models:
            self._feed(model)
            model.update()

    def proceed(self, until: float) -> None:
        """Integrate until a time [s], or an event that is only apart by rounding."""
        close = 1e-9 * TS
        while self.time < until:
            event = min(model.next_event for model in self.models)
            due = event <= until + close
            target = event if due else until
            self.solver.step(self.time, target)
            self.time = target
            for model in self.models:
                model.set_time(target)
                wanted, _ = model.slave.completedIntegratorStep()
                assert not wanted
            if due:
                for model in self.models:
                    model.slave.enterEventMode()
                self._update()
                self.solver.reset(self.time)
            if self.time >= until - close:
                return


def simulate(
    models: list[Model], connections: list, start: float, step: float, steps: int, **inputs
) -> dict[str, np.ndarray]:
    """Return the outputs at start + k step, after an event at that time; inputs are `model__u`."""
    with System(models, connections) as system:
        functions = {name.replace("__", "."): function for name, function in inputs.items()}
        exchange = Exchange(system, start, functions)
        outputs = system.reals(system.outputs())
        rows = []
        for k in range(steps):
            exchange.proceed(start + k * step)
            for reals in outputs:
                reals.get()
            rows.append([value for reals in outputs for value in reals.values])
        return dict(zip(system.outputs(), np.array(rows).T, strict=True))


def exchanged(loop: Loop, fmus: Path, steps: int, step: float = TS) -> dict[str, np.ndarray]:
    """Return the outputs of a loop by model exchange, with the set-point 1 rad."""
    files, starts = loop.files(), loop.starts()
    models = [Model(name, fmus / files[name], starts[name]) for name in files if name != "source"]
    inputs = {f"{m.name}__r": lambda _: 1.0 for m in models if "r" in m.variables}
    connections = [pair for pair in loop.connections() if not pair[0].startswith("source.")]
    return simulate(models, connections, TS, step, steps, **inputs)


# --- loops --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("controller", "options"),
    [
        ("Pid", {}),
        ("PidRbf", {"plant_model": "nonlinear"}),
        ("IpidRbf", {"fmi3": ("all",)}),
        ("IpidRbf", {"fmi3": ("plant",), "plant_model": "nonlinear"}),
        ("IpidRbf", {"target": "supervisor"}),
    ],
)
def test_loop_agrees_with_sequential_co_simulation(fmus, controller, options):
    loop = Loop(controller, overrides=(("plant.theta0", 0.1),), **options)
    columns = exchanged(loop, fmus, 400)
    with loop.system(fmus) as system:
        expected = master.simulate(system, TS, TS, 400, record=list(columns))
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
    columns, others = (exchanged(Loop(controller, fmi3=v), fmus, 100) for v in ((), ("all",)))
    assert columns.keys() == others.keys()
    for name, column in columns.items():
        np.testing.assert_array_equal(column, others[name])


@pytest.mark.parametrize(("step", "steps", "samples"), [(0.0003, 31, 10), (0.0025, 31, 76)])
def test_communication_points_need_not_be_at_events(fmus, step, steps, samples):
    """The state does not depend on when it is looked at."""
    loop = Loop("Pid", overrides=(("plant.theta0", 0.1),))
    columns, expected = exchanged(loop, fmus, steps, step), exchanged(loop, fmus, samples)
    for name in ("plant.theta", "controller.e"):
        assert columns[name][-1] == pytest.approx(expected[name][-1], abs=1e-9)


def test_continuous_inputs_reach_a_plant_between_events(fmus):
    """Two plants, of which the angle of one is the force on the other, are one linear system."""
    models = [
        Model("driven", fmus / "Pendulum_fmi3.fmu"),
        Model("free", fmus / "Pendulum.fmu", {"theta0": 0.1}),
    ]
    columns = simulate(models, [("free.theta", "driven.u")], 0.0, 0.1, 11)
    A, B = reference.linear_model()
    both = np.block([[A, np.zeros((4, 4))], [np.zeros((4, 4)), A]])
    both[4:, 2] = B
    exact = solve(lambda y: both @ y, [0, 0, 0.1, 0, 0, 0, 0, 0], 1)
    assert columns["free.theta"][-1] == pytest.approx(exact[2, -1], rel=1e-8)
    assert columns["driven.theta"][-1] == pytest.approx(exact[6, -1], rel=1e-8)


def solve(derivative: Callable, initial, until: float, points: int = 2) -> np.ndarray:
    """Integrate an equation; return the state at points in time, (states, points)."""
    times = np.linspace(0, until, points)
    options = {"method": "DOP853", "t_eval": times, "rtol": 1e-12, "atol": 1e-14}
    return solve_ivp(lambda _, y: derivative(y), (0, until), initial, **options).y


# --- the plant alone ----------------------------------------------------------------------------

EQUATIONS = {
    "linear": lambda y, u: reference.linear_model()[0] @ y + reference.linear_model()[1] * u,
    "nonlinear": reference.derivatives,
}
"""The derivative of the state (x, v, theta, omega)."""

each_equation = pytest.mark.parametrize("plant_model", EQUATIONS)


@each_equation
def test_plant_agrees_with_scipy_when_the_force_jumps(file, plant_model):
    force = [(0.0, 1.0), (0.5, 1.0), (0.5, -4.0), (1.0, -4.0)]
    number = {"linear": 2, "nonlinear": 3}[plant_model]
    results = fmpy.simulate_fmu(
        str(file("Pendulum")), fmi_type="ModelExchange", solver="CVode",
        stop_time=1.0, output_interval=0.1, relative_tolerance=1e-10,
        start_values={"theta0": 0.2, "v0": -0.3, "model": number},
        input=np.array(force, dtype=[("time", float), ("u", float)]),
        output=["x", "v", "theta", "omega"],
    )  # fmt: skip
    first = solve(lambda y: EQUATIONS[plant_model](y, 1.0), [0, -0.3, 0.2, 0], 0.5, 6)
    second = solve(lambda y: EQUATIONS[plant_model](y, -4.0), first[:, -1], 0.5, 6)
    regular = results[np.searchsorted(results["time"], np.linspace(0, 1, 11) - 1e-9)]
    expected = np.hstack([first, second[:, 1:]])
    for name, column in zip(("x", "v", "theta", "omega"), expected, strict=True):
        np.testing.assert_allclose(regular[name], column, rtol=1e-7, atol=1e-8)


class Plant(Model):
    """The pendulum in the continuous-time mode, with its states in the order of the file."""

    def __init__(self, path: Path, model: str):
        super().__init__("plant", path, {"model": model, "theta0": 0.1})
        self.initialize(0.0)
        self.update()
        unknowns = [unknown.variable for unknown in self.description.derivatives]
        self.order = [unknown.derivative.name for unknown in unknowns]

    def references(self, names) -> list[int]:
        """Return the value references of variables."""
        return [self.variable(name).valueReference for name in names]

    def put(self, values) -> None:
        """Set the states STATES and the force."""
        by_name = dict(zip([*STATES, "u"], values, strict=True))
        states = (c_double * 4)(*[by_name[name] for name in self.order])
        self.slave.setContinuousStates(states, 4)
        self.set("u", by_name["u"])

    def read(self, names) -> np.ndarray:
        """Return variables by their names."""
        return np.array([self.get(name) for name in names])


@pytest.fixture
def plant(file, plant_model) -> Iterator[Plant]:
    """Return a pendulum in the continuous-time mode."""
    with Plant(file("Pendulum"), plant_model) as plant:
        yield plant


UNKNOWNS = [f"der({name})" for name in STATES] + STATES


@each_equation
def test_derivatives_are_those_of_the_equations(plant, plant_model):
    plant.put([*SWING, 3.0])
    theta, omega, x, v = SWING
    expected = EQUATIONS[plant_model](np.array([x, v, theta, omega]), 3.0)
    values = (c_double * 4)()
    plant.derivatives(values)
    derivatives = dict(zip(plant.order, values, strict=True))
    for name, value in zip(("x", "v", "theta", "omega"), expected, strict=True):
        assert derivatives[name] == pytest.approx(value, rel=1e-12)
        assert plant.get(f"der({name})") == derivatives[name]
    np.testing.assert_array_equal(plant.read(STATES), SWING)


@each_equation
def test_directional_derivatives_match_central_differences(plant):
    point, step = np.array([*SWING, 3.0]), 1e-4
    unknowns, knowns = plant.references(UNKNOWNS), plant.references([*STATES, "u"])
    derivative = plant.slave.getDirectionalDerivative
    columns = []
    for j, known in enumerate(knowns):
        sides = []
        for sign in (1, -1):
            shifted = point.copy()
            shifted[j] += sign * step
            plant.put(shifted)
            sides.append(plant.read(UNKNOWNS))
        difference = (sides[0] - sides[1]) / (2 * step)
        plant.put(point)
        columns.append(derivative(unknowns, [known], [1.0]))
        np.testing.assert_allclose(columns[-1], difference, rtol=1e-6, atol=1e-6)
    seed = [0.5, -2.0, 1.0, 3.0, 7.0]
    expected = np.array(columns).T @ seed
    np.testing.assert_allclose(derivative(unknowns, knowns, seed), expected, rtol=1e-13, atol=1e-13)


@each_equation
def test_the_state_of_the_fmu_keeps_the_continuous_states(plant):
    plant.put([*SWING, 3.0])
    expected = plant.read(UNKNOWNS)
    get, put, free = states_of(plant)
    state = get()
    plant.put([0.0, 1.0, 2.0, 3.0, 4.0])
    assert not np.array_equal(plant.read(UNKNOWNS), expected)
    put(state)
    np.testing.assert_array_equal(plant.read(UNKNOWNS), expected)
    free(state)


# --- controllers --------------------------------------------------------------------------------


def states_of(model: Model) -> tuple:
    """Return the functions that get, set and free the state of an FMU; 3.0 spells them anew."""
    slave, state = model.slave, "state" if model.description.fmiVersion == "2.0" else "State"
    return tuple(getattr(slave, f"{verb}FMU{state}") for verb in ("get", "set", "free"))


@pytest.fixture
def controller(file) -> Iterator[Model]:
    """Return a PidRbf with the sample time 0.01 s in its first event, at t = 0.5 s."""
    start = {"ts": 0.01, "rbf.w0[1]": 2.0, "r": 1.0, "u_max": 1e4}
    with Model("controller", file("PidRbf"), start) as model:
        model.initialize(0.5)
        yield model


def sample(model: Model, y: float, time: float | None = None) -> float:
    """Go to the next event, take a sample of the angle, and return the force."""
    model.set_time(model.next_event if time is None else time)
    model.slave.enterEventMode()
    model.set("y", y)
    model.update()
    return model.get("u")


def test_samples_are_time_events(controller):
    assert controller.states == 0
    controller.set("y", 0.9)
    controller.update()
    first = controller.get("u")
    assert controller.get("e") == 1.0 - 0.9
    for k in range(1, 200):
        assert controller.next_event == pytest.approx(0.5 + k * 0.01, abs=1e-12)
        sample(controller, 0.9)
    assert controller.get("u") > 2 * first  # the network integrates the error


def test_nothing_happens_between_samples(controller):
    controller.update()
    u, due = controller.get("u"), controller.next_event
    assert sample(controller, 0.5, time=0.505) == u  # an event of another FMU
    assert controller.next_event == due
    assert sample(controller, 0.5) != u


def test_the_state_of_the_fmu_can_be_restored_between_samples(controller):
    controller.update()
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


# --- refusals -----------------------------------------------------------------------------------


def test_the_transfer_function_is_refused(file):
    with (
        Model("plant", file("Pendulum"), {"model": "transfer_function"}) as plant,
        pytest.raises(MasterError, match=r"\bmodel\b.*transfer_function"),
    ):
        plant.initialize(0.0)


def test_the_source_is_for_co_simulation_only(file):
    assert fmpy.read_model_description(file("Source")).modelExchange is None
