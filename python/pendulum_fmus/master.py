"""Couple co-simulation FMUs from any vendor with FMPy, at a fixed communication step.

    with System(
        [
            Component("controller", "target/fmu/Pid.fmu", sampled=True),
            Component("plant", "target/fmu/Pendulum.fmu", {"theta0": 0.1}),
        ],
        [("plant.theta", "controller.y"), ("controller.u", "plant.u")],
    ) as system:
        results = simulate(system, start=0.001, step=0.001, steps=5000)

There are two orders of stepping. At every communication point t,

- sequential (Gauss-Seidel): one component after another fetches its inputs from the newest
  outputs and steps. With the controller first, the plant receives u(t) at t, without delay;
- parallel (Jacobi): all components fetch their inputs, then all step. The plant receives u(t) one
  step later. Most tools use this order.

FMUs of FMI 2.0 and 3.0 can be coupled. Elements of the arrays of FMI 3.0 have names like
the scalar variables of FMI 2.0: `rbf.w[2]`.
"""

import math
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager
from ctypes import c_double, sizeof

import numpy as np
from tqdm import tqdm

from .fmi import Component, MasterError, Reals

__all__ = ["Component", "MasterError", "Reals", "System", "simulate", "steps_until"]

ORDERS = ("sequential", "parallel")

MAX_STEPS = 10**7
"""Maximum number of steps; more are assumed to be a mistake in `step` or `stop`."""


class System(AbstractContextManager):
    """Components and the connections between them.

    Parameters
    ----------
    components
        In the order of sequential stepping.
    connections
        Pairs of names, ("plant.theta", "controller.y"): from an output to an input.
    """

    def __init__(self, components: Sequence[Component], connections: Sequence[tuple[str, str]]):
        self.components = {component.name: component for component in components}
        if len(self.components) < len(components):
            raise MasterError("two components have the same name")
        self.connections, self.sources = list(connections), {}
        for pair in self.connections:
            for name, causality in zip(pair, ("output", "input"), strict=True):
                component, variable = self.locate(name)
                if component.variable(variable).causality != causality:
                    raise MasterError(f"{name} is connected as an {causality}, but is none")
            if pair[1] in self.sources:
                raise MasterError(f"{pair[1]} is connected twice")
            self.sources[pair[1]] = pair[0]

    def locate(self, name: str) -> tuple[Component, str]:
        """Split "component.variable" and look up the component."""
        component, _, variable = name.partition(".")
        if component not in self.components:
            known = ", ".join(self.components)
            raise MasterError(f"{name}: there is no component {component!r}, only {known}")
        return self.components[component], variable

    def reals(self, names: Iterable[str]) -> list[Reals]:
        """Return the Reals of each component among variables with some full names."""
        found: dict[str, list[str]] = {name: [] for name in self.components}
        for component, variable in map(self.locate, names):
            found[component.name].append(variable)
        return [Reals(self.components[name], variables) for name, variables in found.items()]

    def unit(self, name: str) -> str:
        """Return the unit of "component.variable"."""
        component, variable = self.locate(name)
        return component.unit(variable)

    def outputs(self) -> list[str]:
        """Return the full names of all outputs."""
        return [f"{c.name}.{name}" for c in self.components.values() for name in c.outputs()]

    def close(self) -> None:
        """Close all components."""
        for component in self.components.values():
            component.close()

    def __exit__(self, *_exception) -> None:
        self.close()


def simulate(
    system: System,
    start: float,
    step: float,
    steps: int,
    *,
    order: str = "sequential",
    record: Sequence[str] | None = None,
    progress: bool = False,
) -> dict[str, np.ndarray]:
    """Initialize the system at `start` [s] and take `steps` communication steps of `step` [s].

    A system can be simulated again: it starts from the values that were set before and since.

    Returns the time [s] and the variables `record` (all outputs by default), each of shape
    (steps,); enumerations as the numbers of their items. Row k belongs to t(k) = start + k step:
    the outputs of plants and sources at t(k), and the outputs of the sample that a controller
    takes at t(k).
    """
    if isinstance(record, str):
        raise MasterError(
            f"record is {record!r}; a list of names is expected, such as [{record!r}]"
        )
    if order not in ORDERS:
        raise MasterError(f"order is {order!r}; {' or '.join(ORDERS)} is expected")
    record = system.outputs() if record is None else record
    others = {
        name: (component, variable, [])
        for name in record
        for component, variable in [system.locate(name)]
        if component.variable(variable).type != component.real
    }
    inputs, outputs = (
        system.reals(system.sources),
        system.reals([*system.sources.values(), *(n for n in record if n not in others)]),
    )
    # All outputs share one row, from which inputs are copied
    row, columns, first = (c_double * sum(reals.size for reals in outputs))(), {}, 0
    for reals in outputs:
        reals.values = (c_double * reals.size).from_buffer(row, first * sizeof(c_double))
        for name, position in zip(reals.names, reals.positions, strict=True):
            columns[f"{reals.component.name}.{name}"] = first + position
        first += reals.size
    pairs = [
        [
            (to, columns[system.sources[f"{reals.component.name}.{name}"]])
            for name, to in zip(reals.names, reals.positions, strict=True)
        ]
        for reals in inputs
    ]
    nodes = list(zip(inputs, pairs, outputs, strict=True))

    def fetch(given: Reals, pairs: Sequence[tuple[int, int]]) -> None:
        for to, of in pairs:
            given.values[to] = row[of]
        if pairs:
            given.set()

    def keep() -> None:
        for component, variable, values in others.values():
            values.append(component.get(variable))

    for component in system.components.values():
        component.initialize(start)
    for reals in outputs:
        reals.get()
    newest, rows = np.ctypeslib.as_array(row), np.empty((steps + 1, len(row)))
    hidden = None if progress else True  # None shows the bar on a terminal only
    for k in tqdm(range(steps), unit="step", delay=1, leave=False, disable=hidden):
        rows[k] = newest
        keep()
        time = start + k * step  # not accumulated, since 20000 rounding errors would add up
        if order == "parallel":
            for given, from_, _ in nodes:
                fetch(given, from_)
        for given, from_, read in nodes:
            if order == "sequential":
                fetch(given, from_)
            given.component.step(time, step)
            read.get()
    rows[steps] = newest
    keep()
    results = {"time": start + step * np.arange(steps)}
    for name in record:
        late = int(system.locate(name)[0].sampled)  # known after the step from the sample
        column = np.array(others[name][2]) if name in others else rows[:, columns[name]]
        results[name] = np.ascontiguousarray(column[late : late + steps])
    return results


def steps_until(stop: float, start: float, step: float) -> int:
    """Return the number of communication points start + k step up to `stop` [s]."""
    if not (math.isfinite(start) and math.isfinite(stop) and stop >= start):
        raise MasterError(f"the stop time {stop} s is before the start time {start} s")
    if not 0 < step < math.inf:
        raise MasterError(f"the step {step} s is not a positive number")
    steps = (stop - start) / step
    if steps > MAX_STEPS:
        raise MasterError(f"{steps:.3g} steps are too many; at most {MAX_STEPS} are allowed")
    return math.floor(steps + 1e-6) + 1
