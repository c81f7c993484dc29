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
- parallel (Jacobi): all outputs are read, all inputs are set, then all components step.
  The plant receives u(t) one step later. Most tools use this order.

FMUs of FMI 2.0 and 3.0 can be coupled. Elements of the arrays of FMI 3.0 have names like those of
the scalar variables of FMI 2.0: `rbf.w[2]`.
"""

import difflib
import math
import os
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from copy import copy
from ctypes import byref, c_double, c_uint
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Self

import fmpy
import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.model_description import ModelVariable
from tqdm import tqdm

from . import fmi

CHUNK = 500
"""Steps between two updates of the progress bar: looks smooth at negligible cost."""

MAX_STEPS = 10**7
"""Maximum number of steps; more are assumed to be a mistake in `step` or `stop`."""


class MasterError(Exception):
    """An error that the user can correct; the message says what is wrong and where."""


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

    KIND = "coSimulation"

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
            self.fmi = self._load(stack)
            self.slave = self.fmi.fmu
            self.places: dict[str, tuple[int, int]] = {}
            self.variables = {v.name: v for v in self.description.modelVariables}
            start = dict(start or {})
            self._set_structure(start)
            self.variables = self._scalars()
            for element in self.places.keys() & start.keys():
                self.variables[element].start = start[element]  # arrays are set as a whole
            for variable, value in start.items():
                self.set(variable, value)
            self._resources = stack.pop_all()

    def _load(self, stack: ExitStack) -> fmi.Fmi2:
        """Unzip and instantiate; closing `stack` undoes it."""
        version = self.description.fmiVersion
        if version not in fmi.VERSIONS:
            raise MasterError(f"{self.path} is of FMI {version}; FMI 2.0 or 3.0 is expected")
        if getattr(self.description, self.KIND) is None:
            what = {"coSimulation": "co-simulation", "modelExchange": "model-exchange"}[self.KIND]
            raise MasterError(f"{self.path} is not a {what} FMU")
        folder = stack.enter_context(TemporaryDirectory(prefix="fmu-"))
        try:
            fmpy.extract(self.path, folder)
            instance = fmi.VERSIONS[version](self.description, folder, self.name, self.KIND)
            stack.callback(instance.fmu.freeLibrary)
            instance.instantiate()
        except Exception as error:
            reason = fmi.messages.pop(self.name, None) or error
            raise MasterError(f"{self.path} cannot be instantiated: {reason}") from error
        stack.callback(instance.free)
        return instance

    def _set_structure(self, start: dict[str, Any]) -> None:
        """Set the structural parameters among the start values, and take them out."""
        names = [
            name
            for name in start
            if name in self.variables and self.variables[name].causality == "structuralParameter"
        ]
        if not names:
            return
        with self.explained("configuration"):
            self.slave.enterConfigurationMode()
        for name in names:
            variable, value = self.variables[name], start.pop(name)
            number = _number(f"{self.name}.{name}", variable, value)
            with self.explained(f"{name} = {value}"):
                self.fmi.set(variable.type, variable.valueReference, [number])
            variable.start = str(number)  # the sizes of arrays follow
        with self.explained("configuration"):
            self.slave.exitConfigurationMode()

    def _scalars(self) -> dict[str, ModelVariable]:
        """Return scalar variables and elements of arrays by name."""
        scalars = {}
        for variable in self.description.modelVariables:
            if not variable.dimensions:
                scalars[variable.name] = variable
                continue
            shape = [int(d.start or d.variable.start) for d in variable.dimensions]
            size = math.prod(shape)
            starts = (variable.start or "").split()
            if len(starts) == 1:
                starts *= size
            for index, position in enumerate(np.ndindex(*shape)):
                element = copy(variable)
                element.name = f"{variable.name}[{','.join(str(i + 1) for i in position)}]"
                element.start = starts[index] if index < len(starts) else None
                scalars[element.name] = element
                self.places[element.name] = (index, size)
        return scalars

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
            v.name
            for v in self.variables.values()
            if v.causality == "output" and v.type == self.fmi.REAL
        ]

    def set(self, name: str, value: Any) -> None:
        """Set an input or a parameter."""
        variable = self.variable(name)
        if variable.causality not in ("input", "parameter"):
            kind = variable.causality
            raise MasterError(
                f"{self.name}.{name} has causality {kind}: only inputs and parameters can be set"
            )
        number = _number(f"{self.name}.{name}", variable, value)
        with self.explained(f"{name} = {value}"):
            self.fmi.set(variable.type, variable.valueReference, self._array(variable, number))

    def _array(self, changed: ModelVariable, number: float) -> list[float]:
        """Return the numbers of a variable, all elements if it is one of an array."""
        if changed.name not in self.places:
            return [number]
        changed.start = str(number)  # kept for when another element is set
        elements = [
            v
            for name, v in self.variables.items()
            if name in self.places and v.valueReference == changed.valueReference
        ]
        for element in elements:
            if element.start is None:
                raise MasterError(
                    f"{self.name}.{element.name} needs a value, too: an array is set as a whole"
                )
        return [_number(f"{self.name}.{v.name}", v, v.start) for v in elements]

    def get(self, name: str) -> float:
        """Return the value of a Real variable."""
        reals = Reals(self, [name])
        reals.get()
        return reals.values[reals.positions[0]]

    def initialize(self, time: float) -> None:
        """Go through the initialization mode at `time` [s]."""
        self.time = time
        with self.explained("initialization"):
            self.fmi.initialize(time)
        self._running = True

    def step(self, time: float, step: float) -> None:
        """Step from `time` to `time + step` [s]."""
        self.time = time
        try:
            self.fmi.step(time, step)
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
        logged = fmi.messages.pop(self.name, "the FMU logged no reason")
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
    source
        Variables whose values these get, if these are inputs.

    Attributes
    ----------
    values
        The buffer: the values of variables, and of all elements of the arrays with one of `names`.
    positions
        The places of the variables `names` in the buffer.
    size
        The number of values in the buffer.
    """

    def __init__(self, component: Component, names: Sequence[str], source: "Reals | None" = None):
        variables = [component.variable(name) for name in names]
        for variable in variables:
            if variable.type != component.fmi.REAL:
                raise MasterError(f"{component.name}.{variable.name} is not a {component.fmi.REAL}")
        self.component = component
        self.names = list(names)
        self.positions, references = [], {}
        self.size = 0
        for variable in variables:
            index, size = component.places.get(variable.name, (0, 1))
            if variable.valueReference not in references:
                references[variable.valueReference] = self.size
                self.size += size
            self.positions.append(references[variable.valueReference] + index)
        self.count = len(references)
        self.references = (c_uint * self.count)(*references)
        self._copies = []
        if source and self.positions == source.positions and self.size == source.size:
            self.values = source.values
        else:
            self.values = (c_double * self.size)()
            if source:
                self._source = source.values
                self._copies = list(zip(self.positions, source.positions, strict=True))

    def get(self, into=None) -> None:
        """Read the values into the buffer, or to the C pointer `into`."""
        values = into or self.values
        try:
            self.component.fmi.get_reals(self.references, self.count, values, self.size)
        except FMICallException as error:
            raise self.component.failure(error, ", ".join(self.names)) from None

    def set(self) -> None:
        """Write the values in the buffer, or those of the source, to the FMU."""
        for to, of in self._copies:
            self.values[to] = self._source[of]
        try:
            self.component.fmi.set_reals(self.references, self.count, self.values, self.size)
        except FMICallException as error:
            values = [self.values[position] for position in self.positions]
            pairs = zip(self.names, values, strict=True)
            what = ", ".join(f"{name} = {value!r}" for name, value in pairs)
            raise self.component.failure(error, what) from None


def _read_description(path: Path) -> fmpy.model_description.ModelDescription:
    """Read the model description of an FMU file."""
    if not path.is_file():
        option = " --fmi 3.0" * path.stem.endswith("_fmi3")
        raise MasterError(f"{path} does not exist; run `cargo fmu export{option}` first")
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
            case "Real" | "Float64" | "Float32":
                return float(value)
            case "Enumeration":
                return _item(variable, value)
            case "Boolean":
                return {"true": 1, "1": 1, "false": 0, "0": 0}[str(value).lower()]
            case kind if "Int" in kind:
                return _whole(kind, value)
    except (ValueError, KeyError, TypeError):
        pass
    raise MasterError(f"{name} cannot be set to {value!r}: {_expectation(variable)} is expected")


def _whole(kind: str, value: Any) -> int:
    """Convert to a whole number of the type "Integer", "UInt8" and so on."""
    number = int(value)
    bits = int(kind.partition("Int")[2].replace("eger", "32"))
    lowest = 0 if kind.startswith("U") else -(2 ** (bits - 1))
    if not lowest <= number < lowest + 2**bits or (not isinstance(value, str) and number != value):
        raise ValueError(value)
    return number


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
    kind = variable.type
    if kind == "Boolean":
        return "true or false"
    if kind in ("Real", "Float64", "Float32"):
        return "a number"
    return f"a whole number of type {kind}" if "Int" in kind else f"nothing (type {kind})"


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
            links[fed].append((read, Reals(self.components[fed], inputs, read)))
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
            reals = Reals(system.components[name], variables)
            self.blocks.append((reals, np.empty((steps, reals.size))))

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
            f"{reals.component.name}.{name}": np.ascontiguousarray(block[:, position])
            for reals, block in self.blocks
            for name, position in zip(reals.names, reals.positions, strict=True)
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
