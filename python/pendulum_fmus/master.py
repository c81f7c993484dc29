"""Couple co-simulation FMUs with FMPy: the reference for the native master, `fmu_master`.

    with FmpySystem(
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

FMUs of FMI 2.0 and 3.0 can be coupled. Elements of the arrays of FMI 3.0 have names like the scalar
variables of FMI 2.0: `rbf.w[2]`. The native master gives the same results, bit for bit, and checks
names, types and connections before it starts.
"""

import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from ctypes import c_double, c_uint, sizeof
from itertools import zip_longest
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import fmpy
import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.model_description import ModelVariable
from tqdm import tqdm

ORDERS = ("sequential", "parallel")

WARNING = 1
"""The highest status of a call that has done what it should."""


class MasterError(Exception):
    """An error that the user can correct; the message says what is wrong and where."""


class Component(AbstractContextManager):
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

    interface = "CoSimulation"  # the type of instances, as FMPy names it
    reason = ""  # the newest log message of a failure, of any FMU
    callbacks = None  # of the newest FMU of FMI 2.0, to which FMPy passes the messages of all

    def __init__(
        self,
        name: str,
        path: str | os.PathLike,
        start: Mapping[str, Any] | None = None,
        *,
        sampled: bool = False,
    ):
        self.name, self.path, self.sampled = name, Path(path), sampled
        self.time, self.start = math.nan, dict(start or {})
        with ExitStack() as stack:
            folder = stack.enter_context(TemporaryDirectory(ignore_cleanup_errors=True))
            with self._explained("instantiation"):
                self.description = fmpy.read_model_description(self.path)
                fmpy.extract(self.path, folder)
                self.fmu = fmpy.instantiate_fmu(
                    folder, self.description, self.interface, debug_logging=True, logger=_log
                )
            stack.callback(self.fmu.freeInstance)
            Component.callbacks = self.fmu.callbacks or Component.callbacks
            self.version = self.description.fmiVersion[0]
            self.real = "Real" if self.version == "2" else "Float64"
            self._set_start_values()
            self._resources = stack.pop_all()

    def _set_start_values(self) -> None:
        """Set the start values; first structural parameters, which give arrays their sizes."""
        variables = {v.name: v for v in self.description.modelVariables}
        self.elements = {name: [name] for name in variables}
        sizes = [v for v in variables.values() if v.causality == "structuralParameter"]
        sizes = [variable for variable in sizes if variable.name in self.start]
        if sizes:
            self.fmu.enterConfigurationMode()
            for variable in sizes:
                self._write(variable)
                variable.start = self.start[variable.name]
            self.fmu.exitConfigurationMode()
        for name, variable in variables.items():
            if variable.dimensions:
                shape = [int(d.start or d.variable.start) for d in variable.dimensions]
                places = [",".join(str(i + 1) for i in index) for index in np.ndindex(*shape)]
                self.elements[name] = [f"{name}[{place}]" for place in places]
        names = self.elements.items()
        self.variables = {element: variables[name] for name, own in names for element in own}
        for variable in dict.fromkeys(map(self.variable, self.start)):
            if variable not in sizes:
                self._write(variable)

    def variable(self, name: str) -> ModelVariable:
        """Look up a variable; for an element of an array, the array."""
        if name not in self.variables:
            raise MasterError(f"{self.path.name} has no variable {name}")
        return self.variables[name]

    def outputs(self) -> list[str]:
        """Return the names of the Real outputs, in the order of the model description."""
        outputs = ((n, v) for n, v in self.variables.items() if v.causality == "output")
        return [name for name, variable in outputs if variable.type == self.real]

    def set(self, name: str, value: Any) -> None:
        """Set an input or a parameter; an element of an array with the others."""
        variable, self.start[name] = self.variable(name), value
        self._write(variable)

    def _write(self, variable: ModelVariable) -> None:
        """Set a variable to its values among the start values."""
        names = self.elements[variable.name]
        starts = str(variable.start or "").split()[: len(names)]
        starts = starts * len(names) if len(starts) == 1 else starts
        values = [self.start.get(name, own) for name, own in zip_longest(names, starts)]
        with self._explained(", ".join(map("{} = {}".format, names, values))):
            numbers = [_number(variable, value) for value in values]
            self._access("set", variable)([variable.valueReference], numbers)

    def get(self, name: str) -> Any:
        """Return the value of a variable; of an enumeration, the number of the item."""
        variable = self.variable(name)
        names = self.elements[variable.name]
        size = [] if self.version == "2" else [len(names)]
        with self._explained(name):
            values = self._access("get", variable)([variable.valueReference], *size)
        return values[names.index(name)]

    def _access(self, verb: str, variable: ModelVariable) -> Any:
        """Return FMPy's function that gets or sets variables of a type."""
        integer = "Integer" if self.version == "2" else "Int64"
        return getattr(self.fmu, verb + variable.type.replace("Enumeration", integer))

    def initialize(self, time: float) -> None:
        """Go through the initialization mode at `time` [s]."""
        with self._explained("initialization"):
            if self.version == "2":
                self.fmu.setupExperiment(startTime=time)
                self.fmu.enterInitializationMode()
            else:
                self.fmu.enterInitializationMode(startTime=time)
            self.fmu.exitInitializationMode()
        self.time = time

    def step(self, time: float, step: float) -> None:
        """Step from `time` to `time + step` [s]."""
        self.time = time
        try:
            flags = self.fmu.doStep(time, step)
        except FMICallException as error:
            raise self.failure(error, f"step of {step!r} s") from None
        if flags and flags[1]:
            raise MasterError(f"{self.name} terminates the simulation at t = {time!r} s")

    @contextmanager
    def _explained(self, what: str) -> Iterator[None]:
        """Turn an error in the body into a MasterError; FMPy raises bare exceptions."""
        try:
            yield
        except Exception as error:
            raise self.failure(error, what) from error

    def failure(self, error: Exception, what: str) -> MasterError:
        """Describe a failed call: FMU, variables, time, and the FMU's log message."""
        when = "" if math.isnan(self.time) else f" at t = {self.time!r} s"
        if isinstance(error, FMICallException):
            error = f"{error.function} returned status {error.status}"
        said = f"{self.name} ({self.path.name}), {what}{when}: {error}: {Component.reason}"
        self.time, Component.reason = math.nan, ""
        return MasterError(said.removesuffix(": "))

    def close(self) -> None:
        """Terminate and free the instance, unload the library and remove the unzipped files."""
        with self._resources, suppress(FMICallException):
            if not math.isnan(self.time):
                self.fmu.terminate()
        self.time = math.nan

    def __exit__(self, *_exception) -> None:
        self.close()


def _log(*event: Any) -> None:
    """Keep the message of a failure; the arguments end with status, category and message."""
    if event[-3] > WARNING:
        Component.reason = event[-1].decode(errors="replace")


def _number(variable: ModelVariable, value: Any) -> float | int:
    """Convert a start value, which may be text, to a number of the type of the variable."""
    if variable.type == "Boolean":
        value = {"true": 1, "false": 0}.get(str(value).lower(), value)
    elif variable.type == "Enumeration":
        value = {item.name: item.value for item in variable.declaredType.items}.get(value, value)
    return float(value) if variable.type in ("Real", "Float64", "Float32") else int(str(value))


class Reals:
    """Real variables of one component, by their names in it, with a buffer for their values.

    Attributes
    ----------
    values
        The buffer: the values of variables, and of all elements of the arrays with one of `names`.
    positions
        The position of each of `names` in the buffer.
    """

    def __init__(self, component: Component, names: Iterable[str]):
        self.component, self.names = component, list(dict.fromkeys(names))
        first: dict[int, int] = {}  # positions by value reference
        self.positions, size = [], 0
        for name in self.names:
            variable = component.variable(name)
            elements = component.elements[variable.name]
            if variable.type != component.real:
                raise MasterError(f"{component.name}.{name} is not a {component.real}")
            if variable.valueReference not in first:
                first[variable.valueReference] = size
                size += len(elements)
            self.positions.append(first[variable.valueReference] + elements.index(name))
        self.values = (c_double * size)()
        self._references = (c_uint * len(first))(*first), len(first)
        self._size = [] if component.version == "2" else [size]
        # The functions themselves, since FMPy's take longer
        functions = (f"fmi{component.version}{verb}{component.real}" for verb in ("Get", "Set"))
        self._get, self._set = (getattr(component.fmu.dll, function) for function in functions)

    def get(self) -> None:
        """Read the values into the buffer."""
        self._call(self._get)

    def set(self) -> None:
        """Write the values in the buffer to the FMU."""
        self._call(self._set)

    def _call(self, function: Any) -> None:
        instance = self.component.fmu.component
        status = function(instance, *self._references, self.values, *self._size)
        if status > WARNING:
            pairs = zip(self.names, self.positions, strict=True)
            what = ", ".join(f"{name} = {self.values[position]!r}" for name, position in pairs)
            raise self.component.failure(FMICallException(function.__name__, status), what)


class FmpySystem(AbstractContextManager):
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
        self.connections = list(connections)

    def locate(self, name: str) -> tuple[Component, str]:
        """Split "component.variable" and look up the component."""
        component, _, variable = name.partition(".")
        if component not in self.components:
            raise MasterError(f"{name}: there is no component {component!r}")
        return self.components[component], variable

    def reals(self, names: Iterable[str]) -> list[Reals]:
        """Return the Reals of each component among variables with some full names."""
        found: dict[str, list[str]] = {name: [] for name in self.components}
        for component, variable in map(self.locate, names):
            found[component.name].append(variable)
        return [Reals(self.components[name], variables) for name, variables in found.items()]

    def __exit__(self, *_exception) -> None:
        for component in self.components.values():
            component.close()


def simulate(
    system: FmpySystem,
    start: float,
    step: float,
    steps: int,
    *,
    order: str = "sequential",
    record: Sequence[str] | None = None,
    progress: bool = False,
) -> dict[str, np.ndarray]:
    """Initialize the system at `start` [s] and take `steps` communication steps of `step` [s].

    Returns the time [s] and the Real variables `record` (all outputs by default), each of shape
    (steps,). Row k belongs to t(k) = start + k step: the outputs of plants and sources at t(k),
    and the outputs of the sample that a controller takes at t(k).
    """
    is_parallel = {"sequential": False, "parallel": True}[order]
    if record is None:
        record = [f"{c.name}.{n}" for c in system.components.values() for n in c.outputs()]
    outputs = system.reals([*(output for output, _ in system.connections), *record])
    inputs = system.reals(input_ for _, input_ in system.connections)
    # All outputs share one row, from which inputs are copied
    row, columns, first = (c_double * sum(len(reals.values) for reals in outputs))(), {}, 0
    for reals in outputs:
        for name, position in zip(reals.names, reals.positions, strict=True):
            columns[f"{reals.component.name}.{name}"] = first + position
        reals.values = type(reals.values).from_buffer(row, first * sizeof(c_double))
        first += len(reals.values)
    fed = {input_: columns[output] for output, input_ in system.connections}
    copies = [
        [(to, fed[f"{r.component.name}.{n}"]) for n, to in zip(r.names, r.positions, strict=True)]
        for r in inputs
    ]

    def fetch(inputs: Reals, pairs: Sequence[tuple[int, int]]) -> None:
        for position, column in pairs:
            inputs.values[position] = row[column]
        if pairs:
            inputs.set()

    for component in system.components.values():
        component.initialize(start)
    for reals in outputs:
        reals.get()
    newest, rows = np.ctypeslib.as_array(row), np.empty((steps + 1, len(row)))
    nodes = list(zip(inputs, copies, outputs, strict=True))
    hidden = None if progress else True  # None shows the bar on a terminal only
    for k in tqdm(range(steps), unit="step", delay=1, leave=False, disable=hidden):
        rows[k] = newest
        time = start + k * step  # not accumulated, since 20000 rounding errors would add up
        if is_parallel:
            for own, pairs, _ in nodes:
                fetch(own, pairs)
        for own, pairs, new in nodes:
            if not is_parallel:
                fetch(own, pairs)
            own.component.step(time, step)
            new.get()
    rows[steps] = newest
    results = {"time": start + step * np.arange(steps)}
    for name in record:
        late = int(system.locate(name)[0].sampled)  # known after the step from the sample
        results[name] = np.ascontiguousarray(rows[late : late + steps, columns[name]])
    return results
