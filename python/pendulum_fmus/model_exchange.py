"""Simulate FMUs of FMI 2.0 and 3.0 by model exchange: CVode integrates all continuous states.

    with System(
        [
            Model("controller", "target/fmu/Pid.fmu"),
            Model("plant", "target/fmu/Pendulum.fmu", {"theta0": 0.1}),
        ],
        [("plant.theta", "controller.y"), ("controller.u", "plant.u")],
    ) as system:
        results = simulate(system, start=0.0, step=0.001, steps=5000)

At an event, one component after another fetches its inputs from the newest outputs and updates its
discrete states, as in sequential co-simulation. With the controller first, the plant receives the
force of a sample at the time of the sample.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from ctypes import byref, c_double, sizeof
from functools import partial

import numpy as np
from fmpy.sundials import CVodeSolver

from .master import Component, MasterError, Reals, Recorder, System

TOLERANCE = 1e-12
"""Relative tolerance of the integration; the absolute one is this times a state's nominal value."""


class Model(Component):
    """An instance of a model-exchange FMU.

    Attributes
    ----------
    states
        The number of its continuous states.
    continuous
        Whether it has states or outputs that change between events.
    next_event
        The time of its next time event [s], infinite if there is none.
    """

    KIND = "modelExchange"

    def initialize(self, time: float) -> None:
        """Initialize at `time` [s]; the model is in its event mode then."""
        super().initialize(time)
        self.states = self.description.numberOfContinuousStates
        changing = [v.name for v in self.variables.values() if v.variability == "continuous"]
        self.continuous = self.states > 0 or not set(changing).isdisjoint(self.outputs())
        self.next_event = math.inf
        if self.description.numberOfEventIndicators:
            raise MasterError(f"{self.path.name} has event indicators, which are not supported")

    def set_time(self, time: float) -> None:
        """Set the time [s]."""
        self.time = time
        with self.explained("time"):
            self.slave.setTime(time)

    def update(self) -> None:
        """Update the discrete states until they are consistent."""
        needed = True
        while needed:
            with self.explained("event"):
                needed, terminate, _, _, defined, time = self.fmi.update_discrete_states()
            if terminate:
                raise MasterError(f"{self.name} ends the simulation at t = {self.time!r} s")
        self.next_event = time if defined else math.inf
        if self.next_event <= self.time:
            now, after = f"t = {self.time!r} s", f"t = {time!r} s"
            raise MasterError(f"{self.name}: the event at {after} should follow that at {now}")


class Equations:
    """The equations of a system for CVode: the states of its models one after another."""

    def __init__(self, system: System, inputs: Mapping, time: float, tolerance: float):
        self.system = system
        self.models: list[Model] = list(system.components.values())
        self.error: MasterError | None = None
        self.inputs: dict[str, list] = {model.name: [] for model in self.models}
        for name, function in inputs.items():
            model, variable = system.locate(name)
            self.inputs[model.name].append((Reals(model, [variable]), function))
        # The others need no inputs between events
        self.continuous = [model for model in self.models if model.continuous]
        sizes = np.cumsum([0, *(model.states for model in self.models)]).tolist()
        offsets = [size * sizeof(c_double) for size in sizes]
        self.parts = [part for part in zip(self.models, offsets, strict=False) if part[0].states]
        self.time = time
        self._update()
        self.solver = CVodeSolver(
            nx=sizes[-1],
            nz=0,
            get_x=partial(self._each, "getContinuousStates"),
            set_x=self._keeping_errors(partial(self._each, "setContinuousStates")),
            get_dx=self._keeping_errors(self._get_derivatives),
            get_z=None,
            get_nominals=partial(self._each, "getNominalsOfContinuousStates"),
            set_time=self._keeping_errors(self._set_time),
            input=None,
            startTime=time,
            relativeTolerance=tolerance,
        )

    def _keeping_errors(self, function: Callable) -> Callable:
        """Let the errors of a function be raised after the step, since they cannot pass CVode."""

        def kept(*arguments) -> None:
            try:
                if self.error is None:
                    function(*arguments)
            except MasterError as error:
                self.error = error

        return kept

    def _each(self, function: str, values, _count: int) -> None:
        for model, offset in self.parts:
            with model.explained("continuous states"):
                getattr(model.slave, function)(byref(values.contents, offset), model.states)

    def _set_time(self, time: float) -> None:
        for model in self.continuous:
            model.set_time(time)

    def _get_derivatives(self, values, _count: int) -> None:
        for model in self.continuous:
            self._feed(model)
        for model, offset in self.parts:
            with model.explained("derivatives"):
                model.fmi.get_derivatives(byref(values.contents, offset), model.states)

    def _feed(self, model: Model) -> None:
        for outputs, inputs in self.system.links[model.name]:
            outputs.get()
            inputs.set()
        for reals, function in self.inputs[model.name]:
            reals.values[0] = function(model.time)
            reals.set()

    def _update(self) -> None:
        for model in self.models:
            self._feed(model)
            model.update()
        self._all("enterContinuousTimeMode")

    def _all(self, function: str) -> list:
        results = []
        for model in self.models:
            with model.explained(function):
                results.append(getattr(model.slave, function)())
        return results

    def proceed(self, until: float, close: float) -> None:
        """Integrate `until` a time [s], or an event not farther than `close` [s] from it."""
        while self.time < until:
            event = min(model.next_event for model in self.models)
            wanted = self._integrate(event if event <= until + close else until)
            if event > self.time and not wanted:
                return
            self._all("enterEventMode")
            self._update()
            self.solver.reset(self.time)
            if abs(self.time - until) <= close:
                return

    def _integrate(self, until: float) -> bool:
        """Return whether a model wants an event."""
        try:
            self.solver.step(self.time, until)
        except RuntimeError as error:
            raise self.error or MasterError(f"at t = {self.time!r} s: {error}") from error
        if self.error:
            raise self.error
        self.time = until
        for model in self.models:
            model.set_time(until)
        return any(wanted for wanted, _terminate in self._all("completedIntegratorStep"))


def simulate(
    system: System,
    start: float,
    step: float,
    steps: int,
    *,
    inputs: Mapping[str, Callable[[float], float]] | None = None,
    record: Sequence[str] | None = None,
    tolerance: float = TOLERANCE,
) -> dict[str, np.ndarray]:
    """Initialize the system of `Model`s at `start` [s] and integrate it.

    `inputs` are functions of time [s] by the full names of the inputs that they give. Returns the
    time [s] and the variables `record` (all Real outputs by default), each of shape (steps,). Row k
    has the values at start + k step, after an event at that time.
    """
    for model in system.components.values():
        model.initialize(start)
    equations = Equations(system, inputs or {}, start, tolerance)
    recorder = Recorder(system, system.outputs() if record is None else record, steps)
    rows = recorder.rows(sampled=False) + recorder.rows(sampled=True)
    for k in range(steps):
        # Events are at this point if they are only apart by rounding
        equations.proceed(start + k * step, 1e-9 * step)
        for reals, values, stride in rows:
            reals.get(byref(values, k * stride))
    return {"time": start + step * np.arange(steps), **recorder.results()}
