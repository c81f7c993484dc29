"""Model exchange in FMI 2.0 and 3.0: loops, and the plant alone.

`cargo fmu validate` compares directional derivatives with difference quotients.
"""

import math
from collections.abc import Callable
from ctypes import c_double
from pathlib import Path

import fmpy
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import reference
from pendulum_fmus import master
from pendulum_fmus.loop import TS, Loop
from pendulum_fmus.master import Component, MasterError, Reals, System

VERSIONS = {"2.0": "", "3.0": "_fmi3"}
"""The endings of the names of FMUs."""

pytestmark = pytest.mark.filterwarnings("error")


@pytest.fixture(params=VERSIONS)
def file(fmus: Path, request) -> Callable[[str], Path]:
    """Return a function that names the FMU of a model, in each version of FMI."""
    return lambda model: fmus / f"{model}{VERSIONS[request.param]}.fmu"


def solve(derivative: Callable, initial, times: np.ndarray) -> np.ndarray:
    """Integrate an equation; return the states at points in time [s], (states, points)."""
    options = {"method": "DOP853", "t_eval": times, "rtol": 1e-12, "atol": 1e-14}
    return solve_ivp(derivative, (times[0], times[-1]), initial, **options).y


# --- a master by model exchange -----------------------------------------------------------------


class Model(Component):
    """An instance for model exchange; it is in its event mode after the initialization."""

    KIND, CLASS = "modelExchange", "Model"

    def initialize(self, time: float) -> None:
        """Initialize it at a time [s]."""
        super().initialize(time)
        self.fmi2 = self.description.fmiVersion == "2.0"
        self.states = (c_double * self.description.numberOfContinuousStates)()
        self.feeds: list[tuple[Reals, Reals]] = []

    def feed(self) -> None:
        """Fetch the inputs from other models."""
        for fed, source in self.feeds:
            source.get()
            fed.values[0] = source.values[0]
            fed.set()

    def update(self) -> None:
        """Fetch the inputs, update the discrete states, and enter the continuous-time mode."""
        self.feed()
        update = self.slave.newDiscreteStates if self.fmi2 else self.slave.updateDiscreteStates
        needed, _, _, _, defined, time = update()
        assert not needed
        self.next_event = time if defined else math.inf
        self.slave.enterContinuousTimeMode()

    def place(self, time: float, states: np.ndarray) -> None:
        """Set the time [s] and the states."""
        self.slave.setTime(time)
        self.states[:] = states
        if len(states):
            self.slave.setContinuousStates(self.states, len(states))

    def derivatives(self) -> list[float]:
        """Fetch the inputs, and return the derivatives of the states."""
        self.feed()
        get = self.slave.getDerivatives if self.fmi2 else self.slave.getContinuousStateDerivatives
        if self.states:
            get(self.states, len(self.states))
        return list(self.states)


def simulate(models: list[Model], connections: list, steps: int) -> dict[str, np.ndarray]:
    """Return the outputs after each event, which all are at the samples of the controllers.

    The states of all models are integrated together, from event to event.
    """
    with System(models, connections) as system:
        for model in models:
            model.initialize(TS)
        for output, input_ in system.connections:
            (source, variable), (fed, name) = system.locate(output), system.locate(input_)
            fed.feeds.append((Reals(fed, [name]), Reals(source, [variable])))
        states = []
        for model in models:
            model.update()
            model.slave.getContinuousStates(model.states, len(model.states))
            states += model.states
        ends = np.cumsum([len(model.states) for model in models])[:-1]

        def rates(time: float, states: np.ndarray) -> np.ndarray:
            for model, part in zip(models, np.split(states, ends), strict=True):
                model.place(time, part)
            return np.concatenate([model.derivatives() for model in models])

        time, rows, outputs = TS, [], system.reals(system.outputs())
        for k in range(steps):
            for reals in outputs:
                reals.get()
            rows.append([value for reals in outputs for value in reals.values])
            event = min(model.next_event for model in models)
            assert event == pytest.approx((k + 2) * TS, rel=1e-12)
            states = solve(rates, states, np.array([time, event]))[:, -1]
            time = event
            rates(time, states)
            for model in models:
                wanted, _ = model.slave.completedIntegratorStep()
                assert not wanted
                model.slave.enterEventMode()
            for model in models:
                model.update()
        return dict(zip(system.outputs(), np.array(rows).T, strict=True))


def exchanged(loop: Loop, fmus: Path, steps: int) -> dict[str, np.ndarray]:
    """Return the outputs of a loop by model exchange, with the set-point 1 rad."""
    files, starts = loop.files(), loop.starts()
    del files["source"]
    for name in files.keys() & {"controller", "supervisor"}:
        starts[name]["r"] = 1.0
    models = [Model(name, fmus / file, starts[name]) for name, file in files.items()]
    connections = [pair for pair in loop.connections() if not pair[0].startswith("source.")]
    return simulate(models, connections, steps)


# --- loops --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("controller", "options"),
    [
        ("Pid", {"plant_model": "nonlinear"}),
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


# --- the plant alone ----------------------------------------------------------------------------

EQUATIONS = {
    "linear": lambda y, u: reference.linear_model()[0] @ y + reference.linear_model()[1] * u,
    "nonlinear": reference.derivatives,
}
"""The derivative of the state (x, v, theta, omega)."""


@pytest.mark.parametrize("plant_model", EQUATIONS)
def test_plant_agrees_with_scipy_when_the_force_jumps(file, plant_model):
    force = [(0.0, 1.0), (0.5, 1.0), (0.5, -4.0), (1.0, -4.0)]
    number = {"linear": 2, "nonlinear": 3}[plant_model]
    results = fmpy.simulate_fmu(
        str(file("Pendulum")), fmi_type="ModelExchange", solver="CVode",
        stop_time=1.0, output_interval=0.1, relative_tolerance=1e-10,
        start_values={"theta0": 0.2, "v0": -0.3, "dynamics": number},
        input=np.array(force, dtype=[("time", float), ("u", float)]),
        output=["x", "v", "theta", "omega"],
    )  # fmt: skip
    equation, times = EQUATIONS[plant_model], np.linspace(0, 0.5, 6)
    first = solve(lambda _, y: equation(y, 1.0), [0, -0.3, 0.2, 0], times)
    second = solve(lambda _, y: equation(y, -4.0), first[:, -1], times)
    regular = results[np.searchsorted(results["time"], np.linspace(0, 1, 11) - 1e-9)]
    expected = np.hstack([first, second[:, 1:]])
    for name, column in zip(("x", "v", "theta", "omega"), expected, strict=True):
        np.testing.assert_allclose(regular[name], column, rtol=1e-7, atol=1e-8)


def test_what_has_no_equations_is_refused(file):
    with (
        Model("plant", file("Pendulum"), {"dynamics": "transfer_function"}) as plant,
        pytest.raises(MasterError, match=r"\bdynamics\b.*transfer_function"),
    ):
        plant.initialize(0.0)
