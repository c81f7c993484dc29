"""Couple FMI 2.0 co-simulation FMUs from any vendor with FMPy, at a fixed communication step.

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
- parallel (Jacobi): all outputs are read, all inputs are set, then all components step.
  The plant receives u(t) one step later. Most tools use this order.
"""

import difflib
import math
import os
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from ctypes import byref, c_double, c_int, c_uint
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Self

import fmpy
import numpy as np
from fmpy import calloc, free
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import (
    FMU2Slave,
    fmi2CallbackAllocateMemoryTYPE,
    fmi2CallbackFreeMemoryTYPE,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
)
from fmpy.logging import addLoggerProxy
from fmpy.model_description import ModelVariable
from tqdm import tqdm

CHUNK = 500
"""Steps between two updates of the progress bar: looks smooth at negligible cost."""

MAX_STEPS = 10**7
"""Maximum number of steps; more are assumed to be a mistake in `step` or `stop`."""


class MasterError(Exception):
    """An error that the user can correct; the message says what is wrong and where."""


# --- log messages -------------------------------------------------------------------------------

_messages: dict[str, str] = {}


def _log(_environment, instance: bytes, _status: int, _category: bytes, message: bytes) -> None:
    """Keep the newest message of every instance, which explains the status of a failed call."""
    _messages[instance.decode()] = message.decode(errors="replace")


def _callbacks() -> fmi2CallbackFunctions:
    """Return the callbacks for FMUs: our logger and the C library's memory functions."""
    callbacks = fmi2CallbackFunctions()
    callbacks.logger = fmi2CallbackLoggerTYPE(_log)
    callbacks.allocateMemory = fmi2CallbackAllocateMemoryTYPE(calloc)
    callbacks.freeMemory = fmi2CallbackFreeMemoryTYPE(free)
    addLoggerProxy(byref(callbacks))
    return callbacks


# Shared by all instances: FMPy's proxy, which formats variadic messages, supports only one logger.
_CALLBACKS = _callbacks()


# --- components ---------------------------------------------------------------------------------


class Component:
    """An instance of an FMU, from instantiation to `close`.

    Parameters
    ----------
    name
        Prefix of its variables in connections and results: `name.variable`.
    path
        The .fmu file.
    start
        Start values by variable name: numbers, booleans, names of enumeration items, or any of
        these as text.
    sampled
        True for a controller: its outputs after a step from t to t+h belong to the sample taken
        at t. False for a plant or a source: they are the values at t+h.
    """

    def __init__(
        self,
        name: str,
        path: str | os.PathLike,
        start: Mapping[str, Any] | None = None,
        *,
        sampled: bool = False,
    ):
        self.name = name
        self.path = Path(path)
        self.sampled = sampled
        self.time = math.nan
        self._running = False
        with ExitStack() as stack:
            self.description = _read_description(self.path)
            self.variables = {v.name: v for v in self.description.modelVariables}
            self.slave = self._load(stack)
            self._set_start_values(start or {})
            self._resources = stack.pop_all()

    def _load(self, stack: ExitStack) -> FMU2Slave:
        """Unzip and instantiate; closing `stack` undoes it."""
        if self.description.coSimulation is None:
            raise MasterError(f"{self.path} is not a co-simulation FMU")
        folder = stack.enter_context(TemporaryDirectory(prefix="fmu-"))
        try:
            fmpy.extract(self.path, folder)
            slave = FMU2Slave(
                guid=self.description.guid,
                unzipDirectory=folder,
                modelIdentifier=self.description.coSimulation.modelIdentifier,
                instanceName=self.name,
            )
            stack.callback(slave.freeLibrary)
            slave.instantiate(callbacks=_CALLBACKS, loggingOn=True)
        except Exception as error:
            reason = _messages.pop(self.name, None) or error
            raise MasterError(f"{self.path} cannot be instantiated: {reason}") from error
        stack.callback(slave.fmi2FreeInstance, slave.component)
        return slave

    def variable(self, name: str) -> ModelVariable:
        """Look up a variable; the error for an unknown name suggests similar ones."""
        if name in self.variables:
            return self.variables[name]
        similar = difflib.get_close_matches(name, self.variables, n=3)
        hint = f"; did you mean {' or '.join(similar)}?" if similar else ""
        raise MasterError(f"{self.path.name} has no variable {name}{hint}")

    def unit(self, name: str) -> str:
        """Return the unit of a variable, "1" if it has none."""
        variable = self.variable(name)
        return variable.unit or getattr(variable.declaredType, "unit", None) or "1"

    def outputs(self) -> list[str]:
        """Return the names of the Real outputs, in the order of the model description."""
        return [
            v.name for v in self.variables.values() if v.causality == "output" and v.type == "Real"
        ]

    def set(self, name: str, value: Any) -> None:
        """Set an input or a parameter."""
        variable = self.variable(name)
        if variable.causality not in ("input", "parameter"):
            kind = variable.causality
            raise MasterError(
                f"{self.name}.{name} has causality {kind}: only inputs and parameters can be set"
            )
        setter, c_type = self._setter(variable)
        number = _number(f"{self.name}.{name}", variable, value)
        reference, buffer = (c_uint * 1)(variable.valueReference), (c_type * 1)(number)
        with self.explained(f"{name} = {value}"):
            setter(self.slave.component, reference, 1, buffer)

    def get(self, name: str) -> float:
        """Return the value of a Real variable."""
        reals = Reals(self, [name])
        reals.get()
        return reals.values[0]

    def _setter(self, variable: ModelVariable):
        """Return the FMI function that sets a variable of this type, and its C type."""
        return {
            "Real": (self.slave.fmi2SetReal, c_double),
            "Integer": (self.slave.fmi2SetInteger, c_int),
            "Enumeration": (self.slave.fmi2SetInteger, c_int),
            "Boolean": (self.slave.fmi2SetBoolean, c_int),
        }[variable.type]

    def _set_start_values(self, start: Mapping[str, Any]) -> None:
        for name, value in start.items():
            self.set(name, value)

    def initialize(self, time: float) -> None:
        """Go through the initialization mode at `time` [s]."""
        self.time = time
        with self.explained("initialization"):
            self.slave.setupExperiment(startTime=time)
            self.slave.enterInitializationMode()
            self.slave.exitInitializationMode()
        self._running = True

    def step(self, time: float, step: float) -> None:
        """Step from `time` to `time + step` [s]."""
        self.time = time
        try:
            self.slave.fmi2DoStep(self.slave.component, time, step, True)
        except FMICallException as error:
            raise self.failure(error, f"step of {step!r} s") from None

    @contextmanager
    def explained(self, what: str) -> Iterator[None]:
        """Turn a failed FMI call in the body into a MasterError."""
        try:
            yield
        except FMICallException as error:
            raise self.failure(error, what) from None

    def failure(self, error: FMICallException, what: str) -> MasterError:
        """Describe a failed call: FMU, function, variables, time, and the FMU's log message."""
        self._running = False
        when = "" if math.isnan(self.time) else f" at t = {self.time!r} s"
        logged = _messages.pop(self.name, "the FMU logged no reason")
        return MasterError(
            f"{self.name} ({self.path.name}), {what}{when}:"
            f" {error.function} returned status {error.status}: {logged}"
        )

    def close(self) -> None:
        """Terminate and free the instance, unload the library and remove the unzipped files."""
        if self._running:
            with suppress(FMICallException):
                self.slave.terminate()
        self._running = False
        self._resources.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_exception) -> None:
        self.close()


class Reals:
    """Real variables of one component, resolved to value references, and a buffer for their values.

    Parameters
    ----------
    component
        The instance that the variables belong to.
    names
        Their names, without that of the component.
    values
        The buffer, `len(names)` doubles; passed in if two `Reals` share one.
    """

    def __init__(self, component: Component, names: Sequence[str], values=None):
        variables = [component.variable(name) for name in names]
        for variable in variables:
            if variable.type != "Real":
                raise MasterError(f"{component.name}.{variable.name} is not a Real")
        self.component = component
        self.names = list(names)
        self.count = len(variables)
        self.references = (c_uint * self.count)(*[v.valueReference for v in variables])
        self.values = values or (c_double * self.count)()

    def get(self, into=None) -> None:
        """Read the values into the buffer, or to the C pointer `into`."""
        slave = self.component.slave
        try:
            slave.fmi2GetReal(slave.component, self.references, self.count, into or self.values)
        except FMICallException as error:
            raise self.component.failure(error, ", ".join(self.names)) from None

    def set(self) -> None:
        """Write the values in the buffer to the FMU."""
        slave = self.component.slave
        try:
            slave.fmi2SetReal(slave.component, self.references, self.count, self.values)
        except FMICallException as error:
            values = zip(self.names, self.values, strict=True)
            what = ", ".join(f"{name} = {value!r}" for name, value in values)
            raise self.component.failure(error, what) from None


def _read_description(path: Path) -> fmpy.model_description.ModelDescription:
    """Read the model description of an FMU file."""
    if not path.is_file():
        raise MasterError(f"{path} does not exist; run `cargo fmu export` first")
    try:
        return fmpy.read_model_description(path)
    except (OSError, KeyError, zipfile.BadZipFile) as error:
        raise MasterError(f"{path} cannot be read as an FMU: {error}") from error
    except Exception as error:  # FMPy raises bare exceptions for invalid descriptions
        raise MasterError(f"{path} has an invalid model description: {error}") from error


def _number(name: str, variable: ModelVariable, value: Any) -> float | int:
    """Convert a start value to the number that FMI expects for the type of the variable."""
    try:
        match variable.type:
            case "Real":
                return float(value)
            case "Integer":
                return int(value)
            case "Enumeration":
                return _item(variable, value)
            case "Boolean":
                return {"true": 1, "1": 1, "false": 0, "0": 0}[str(value).lower()]
    except (ValueError, KeyError, TypeError):
        pass
    raise MasterError(f"{name} cannot be set to {value!r}: {_expectation(variable)} is expected")


def _item(variable: ModelVariable, value: Any) -> int:
    """Return the value of an enumeration item, given by name or value."""
    items = {item.name: int(item.value) for item in variable.declaredType.items}
    if value in items:
        return items[value]
    number = int(value)
    if number not in items.values():
        raise ValueError(value)
    return number


def _expectation(variable: ModelVariable) -> str:
    """Describe the values that a variable accepts."""
    if variable.type == "Enumeration":
        return "one of " + ", ".join(item.name for item in variable.declaredType.items)
    return {"Real": "a number", "Integer": "a whole number", "Boolean": "true or false"}.get(
        variable.type, f"nothing (type {variable.type})"
    )


# --- systems ------------------------------------------------------------------------------------


class System:
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
        self.connections = list(connections)
        self._check_connections()
        self.links = self._links()
        self.all_links = [link for links in self.links.values() for link in links]

    def locate(self, name: str) -> tuple[Component, str]:
        """Split "component.variable" and look up the component."""
        component, _, variable = name.partition(".")
        if component not in self.components:
            known = ", ".join(self.components)
            raise MasterError(f"{name}: there is no component {component!r}, only {known}")
        return self.components[component], variable

    def _check_connections(self) -> None:
        targets = set()
        for pair in self.connections:
            for name, causality in zip(pair, ("output", "input"), strict=True):
                component, variable = self.locate(name)
                if component.variable(variable).causality != causality:
                    raise MasterError(f"{name} is connected as an {causality}, but is none")
            if pair[1] in targets:
                raise MasterError(f"{pair[1]} is connected twice")
            targets.add(pair[1])

    def _links(self) -> dict[str, list[tuple[Reals, Reals]]]:
        """Group the connections by pairs of components: {fed: [(outputs, inputs)]}."""
        bundles: dict[tuple[str, str], list[tuple[str, str]]] = {}
        for output, input_ in self.connections:
            (source, output_name), (fed, input_name) = self.locate(output), self.locate(input_)
            bundle = bundles.setdefault((source.name, fed.name), [])
            bundle.append((output_name, input_name))
        links: dict[str, list[tuple[Reals, Reals]]] = {name: [] for name in self.components}
        for (source, fed), pairs in bundles.items():
            outputs, inputs = zip(*pairs, strict=True)
            read = Reals(self.components[source], outputs)
            links[fed].append((read, Reals(self.components[fed], inputs, read.values)))
        return links

    def unit(self, name: str) -> str:
        """Return the unit of "component.variable"."""
        component, variable = self.locate(name)
        return component.unit(variable)

    def outputs(self) -> list[str]:
        """Return the full names of all Real outputs."""
        return [f"{c.name}.{name}" for c in self.components.values() for name in c.outputs()]

    def close(self) -> None:
        """Close all components."""
        for component in self.components.values():
            component.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_exception) -> None:
        self.close()


def step_sequentially(system: System, time: float, step: float) -> None:
    """For each component in turn, fetch its inputs from the newest outputs and step."""
    for name, component in system.components.items():
        for outputs, inputs in system.links[name]:
            outputs.get()
            inputs.set()
        component.step(time, step)


def step_in_parallel(system: System, time: float, step: float) -> None:
    """Read all outputs, set all inputs, then step all components."""
    for outputs, _ in system.all_links:
        outputs.get()
    for _, inputs in system.all_links:
        inputs.set()
    for component in system.components.values():
        component.step(time, step)


ORDERS = {"sequential": step_sequentially, "parallel": step_in_parallel}


class Recorder:
    """Values of variables at every communication point, read directly into NumPy arrays."""

    def __init__(self, system: System, names: Sequence[str], steps: int):
        self.names = list(names)
        by_component: dict[str, list[str]] = {}
        for name in names:
            component, variable = system.locate(name)
            by_component.setdefault(component.name, []).append(variable)
        self.blocks = []
        for name, variables in by_component.items():
            block = np.empty((steps, len(variables)))
            self.blocks.append((Reals(system.components[name], variables), block))

    def rows(self, *, sampled: bool) -> list[tuple[Reals, c_double, int]]:
        """Return (variables, first value, bytes per row) of the sampled or the other components."""
        return [
            (reals, c_double.from_buffer(block), block.strides[0])
            for reals, block in self.blocks
            if reals.component.sampled == sampled
        ]

    def results(self) -> dict[str, np.ndarray]:
        """Return the recorded columns by full name, each of shape (steps,)."""
        columns = {
            f"{reals.component.name}.{name}": np.ascontiguousarray(column)
            for reals, block in self.blocks
            for name, column in zip(reals.names, block.T, strict=True)
        }
        return {name: columns[name] for name in self.names}


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

    Returns the time [s] and the variables `record` (all Real outputs by default), each of shape
    (steps,). Row k belongs to t(k) = start + k step: the outputs of plants and sources at t(k),
    and those of the sample that a controller takes at t(k).
    """
    for component in system.components.values():
        component.initialize(start)
    advance = ORDERS[order]
    recorder = Recorder(system, system.outputs() if record is None else record, steps)
    before, after = recorder.rows(sampled=False), recorder.rows(sampled=True)
    with tqdm(total=steps, unit="step", delay=1, leave=False, disable=_hidden(progress)) as bar:
        for first in range(0, steps, CHUNK):
            for k in range(first, min(first + CHUNK, steps)):
                for reals, values, stride in before:
                    reals.get(byref(values, k * stride))
                # Not accumulated, since rounding errors would add up over 20000 steps
                advance(system, start + k * step, step)
                for reals, values, stride in after:
                    reals.get(byref(values, k * stride))
            bar.update(k + 1 - first)
    return {"time": start + step * np.arange(steps), **recorder.results()}


def _hidden(progress: bool) -> bool | None:
    """Return tqdm's `disable`: None shows the bar only on a terminal."""
    return None if progress else True


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
