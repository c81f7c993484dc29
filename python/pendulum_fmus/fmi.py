"""One FMU in FMPy, with messages that say what is wrong, and one call for all Reals of a step."""

import difflib
import itertools
import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from copy import copy
from ctypes import byref, c_double, c_uint
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import fmpy
import numpy as np
from fmpy import fmi2, fmi3
from fmpy.fmi1 import FMICallException
from fmpy.logging import addLoggerProxy
from fmpy.model_description import ModelDescription, ModelVariable

VERSIONS = {"2.0": (fmi2, "Real"), "3.0": (fmi3, "Float64")}
"""FMPy's module and the type of real numbers, by version of FMI."""

STRUCTURAL = "structuralParameter"

WARNING = 1
"""The status after which a call has done what it should, as after 0."""


class MasterError(Exception):
    """An error that the user can correct; the message says what is wrong and where."""


messages: dict[str, str] = {}
"""The newest log message of every instance, which explains the status of a failed call."""


def _log(_environment, instance: bytes, _status, _category, message: bytes) -> None:
    messages[instance.decode()] = message.decode(errors="replace")


CALLBACKS = fmi2.fmi2CallbackFunctions()
"""The callbacks of all FMUs of FMI 2.0, as FMPy's proxy supports only one logger."""
CALLBACKS.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(fmpy.calloc)
CALLBACKS.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(fmpy.free)


def take_logger() -> None:
    """Receive log messages of FMI 2.0 FMUs; call it again after another logger was installed."""
    CALLBACKS.logger = fmi2.fmi2CallbackLoggerTYPE(_log)
    addLoggerProxy(byref(CALLBACKS))  # formats variadic messages


take_logger()


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

    def __init__(
        self,
        name: str,
        path: str | os.PathLike,
        start: Mapping[str, Any] | None = None,
        *,
        sampled: bool = False,
    ):
        self.name, self.path, self.sampled = name, Path(path), sampled
        self.time, self._running = math.nan, False
        self.description = _read_description(self.path)
        self.variables = {v.name: v for v in self.description.modelVariables}
        self.arrays: dict[str, list[str]] = {}  # all elements of an array, by each of them
        with ExitStack() as stack:
            self._instantiate(stack)
            self._given = dict(start or {})
            self._start()
            self._resources = stack.pop_all()

    def _instantiate(self, stack: ExitStack) -> None:
        """Unzip and instantiate; closing `stack` undoes it."""
        version, interface = self.description.fmiVersion, self.description.coSimulation
        if version not in VERSIONS:
            raise MasterError(f"{self.path} is of FMI {version}; FMI 2.0 or 3.0 is expected")
        self.module, self.real = VERSIONS[version]
        if interface is None:
            raise MasterError(f"{self.path} is not a co-simulation FMU")
        folder = stack.enter_context(TemporaryDirectory(prefix="fmu-"))
        logger: dict[str, Any] = {"callbacks": CALLBACKS}
        if self.module is fmi3:
            name = self.name.encode()
            logger = {"logMessage": lambda _, *event: _log(_, name, *event)}
        try:
            fmpy.extract(self.path, folder)
            self.slave = getattr(self.module, f"FMU{version[0]}Slave")(
                guid=self.description.guid,
                unzipDirectory=folder,
                modelIdentifier=interface.modelIdentifier,
                instanceName=self.name,
            )
            stack.callback(self.slave.freeLibrary)
            self.slave.instantiate(loggingOn=True, **logger)
        except Exception as error:
            reason = messages.pop(self.name, None) or error
            raise MasterError(f"{self.path} cannot be instantiated: {reason}") from error
        stack.callback(lambda: self.function("FreeInstance")(self.slave.component))
        # What a step of FMI 3.0 returns: event, termination, early return, last time
        told = (fmi3.fmi3Boolean, fmi3.fmi3Boolean, fmi3.fmi3Boolean, fmi3.fmi3Float64)
        self._told = [] if self.module is fmi2 else [kind() for kind in told]

    def function(self, name: str) -> Callable:
        """Return a function of the FMU, such as "DoStep", without the checks of FMPy."""
        return getattr(self.slave.dll, f"fmi{self.description.fmiVersion[0]}{name}")

    def _start(self) -> None:
        """Set the start values; first structural parameters, which give arrays their sizes."""
        variables, given = self.variables, self._given
        sizes = [n for n in given if n in variables and variables[n].causality == STRUCTURAL]
        if sizes:
            with self.explained("configuration"):
                self.slave.enterConfigurationMode()
                for name in sizes:
                    variables[name].start = given[name]
                    self._write(name, given[name])
                self.slave.exitConfigurationMode()
        for array in self.description.modelVariables:
            if array.dimensions and array.name in variables:
                self._name_elements(array)
        for name in self.arrays.keys() & given.keys():
            variables[name].start = given[name]
        for name in [name for name in given if name not in sizes]:
            self.set(name, given[name])

    def _name_elements(self, array: ModelVariable) -> None:
        """Replace an array among the variables by its elements."""
        del self.variables[array.name]
        shape = [int(d.start or d.variable.start) for d in array.dimensions]
        places = [",".join(str(i + 1) for i in indices) for indices in np.ndindex(*shape)]
        names = [f"{array.name}[{place}]" for place in places]
        starts = (array.start or "").split()
        starts = starts * len(names) if len(starts) == 1 else starts[: len(names)]
        for name, start in itertools.zip_longest(names, starts):
            self.variables[name] = element = copy(array)
            element.name, element.start = name, start
            self.arrays[name] = names

    def variable(self, name: str) -> ModelVariable:
        """Look up a variable; the error for an unknown name suggests similar ones."""
        if name in self.variables:
            return self.variables[name]
        similar = difflib.get_close_matches(name, self.variables, n=3)
        hint = f"; did you mean {' or '.join(similar)}?" if similar else ""
        raise MasterError(f"{self.path.name} has no variable {name}{hint}")

    def unit(self, name: str) -> str:
        """Return the unit of a variable, "" if it has none."""
        variable = self.variable(name)
        return variable.unit or getattr(variable.declaredType, "unit", None) or ""

    def outputs(self) -> list[str]:
        """Return the names of the outputs, in the order of the model description."""
        return [name for name, v in self.variables.items() if v.causality == "output"]

    def set(self, name: str, value: Any) -> None:
        """Set an input or a parameter."""
        kind = self.variable(name).causality
        if kind not in ("input", "parameter"):
            raise MasterError(
                f"{self.name}.{name} has causality {kind}: only inputs and parameters can be set"
            )
        self._write(name, value)
        self._given[name] = value

    def _write(self, name: str, value: Any) -> None:
        """Set a variable of any type; an element of an array together with the others."""
        variable, elements = self.variables[name], self.arrays.get(name, [name])
        given = {element: self.variables[element].start for element in elements} | {name: value}
        numbers = [_number(f"{self.name}.{n}", variable, v) for n, v in given.items()]
        if name in self.arrays:
            variable.start = value
        with self.explained(f"{name} = {value}"):
            self._access("set", variable)([variable.valueReference], numbers)

    def _access(self, verb: str, variable: ModelVariable) -> Callable:
        """Return FMPy's function that gets or sets variables of a type."""
        kind = variable.type
        if kind == "Enumeration":
            kind = "Integer" if self.module is fmi2 else "Int64"
        return getattr(self.slave, verb + kind)

    def get(self, name: str) -> Any:
        """Return the value of a variable; of an enumeration, the number of the item."""
        variable, elements = self.variable(name), self.arrays.get(name, [name])
        size = {"nValues": len(elements)} if self.module is fmi3 else {}
        with self.explained(name):
            values = self._access("get", variable)([variable.valueReference], **size)
        value = values[elements.index(name)]
        return bool(value) if variable.type == "Boolean" else value

    def initialize(self, time: float) -> None:
        """Go through the initialization mode at `time` [s], again after a reset."""
        if not math.isnan(self.time):
            with self.explained("reset"):
                self.slave.reset()
            self._running = False
            self._start()
        self.time, given = time, {"startTime": time}
        with self.explained("initialization"):
            if self.module is fmi2:
                self.slave.setupExperiment(**given)
                given = {}
            self.slave.enterInitializationMode(**given)
            self.slave.exitInitializationMode()
        self._running = True

    def step(self, time: float, step: float) -> None:
        """Step from `time` to `time + step` [s]."""
        self.time = time
        status = self._do_step(self.slave.component, time, step, True, *map(byref, self._told))
        terminated = bool(self._told) and self._told[1].value
        if status > WARNING or terminated:
            function = self._do_step.__name__ + " with terminateSimulation" * terminated
            raise self.failure(FMICallException(function, status), f"step of {step!r} s")

    @cached_property
    def _do_step(self) -> Callable:
        return self.function("DoStep")

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
        logged = messages.pop(self.name, "the FMU logged no reason")
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

    def __exit__(self, *_exception) -> None:
        self.close()


def _read_description(path: Path) -> ModelDescription:
    """Read the model description of an FMU file."""
    if not path.is_file():
        option = " --fmi 3.0" * path.stem.endswith("_fmi3")
        remedy = f"run `cargo fmu export{option}` first, or name the folder of the FMUs"
        raise MasterError(f"{path} does not exist; {remedy}")
    try:
        return fmpy.read_model_description(path)
    except Exception as error:  # FMPy raises bare exceptions for invalid descriptions
        raise MasterError(f"{path} cannot be read as an FMU: {error}") from error


def _number(name: str, variable: ModelVariable, value: Any) -> float | int:
    """Convert a start value, which may be text, to a number of the type of the variable."""
    kind, words = variable.type, {}
    if kind == "Enumeration":
        words = {item.name: int(item.value) for item in variable.declaredType.items}
        expected, allowed = f"one of {', '.join(words)}", words.values()
    elif kind == "Boolean":
        words, value = {"true": 1, "false": 0}, str(value).lower()
        expected, allowed = "true or false", (0, 1)
    elif "Int" in kind:
        limits = np.iinfo(kind.lower().replace("integer", "int32"))
        expected, allowed = f"a whole number of type {kind}", range(limits.min, limits.max + 1)
    else:
        expected, allowed = "a number", None
    if value is None and variable.dimensions:
        raise MasterError(f"{name} needs a value, too: an array is set as a whole")
    with suppress(ValueError, TypeError):
        if allowed is None:
            return float(value)
        number = words[value] if value in words else int(value)
        if number in allowed and (isinstance(value, str) or number == value):
            return number
    raise MasterError(f"{name} cannot be set to {value!r}: {expected} is expected")


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
        self.positions, self.size = [], 0
        for name in self.names:
            variable, elements = component.variable(name), component.arrays.get(name, [name])
            if variable.type != component.real:
                raise MasterError(f"{component.name}.{name} is not a {component.real}")
            if variable.valueReference not in first:
                first[variable.valueReference] = self.size
                self.size += len(elements)
            self.positions.append(first[variable.valueReference] + elements.index(name))
        self.values = (c_double * self.size)()
        self.count, self.references = len(first), (c_uint * len(first))(*first)
        self._sizes = [] if component.module is fmi2 else [self.size]
        self._get, self._set = (component.function(v + component.real) for v in ("Get", "Set"))

    def get(self) -> None:
        """Read the values into the buffer."""
        self._call(self._get)

    def set(self) -> None:
        """Write the values in the buffer to the FMU."""
        self._call(self._set)

    def _call(self, function: Callable) -> None:
        instance = self.component.slave.component
        status = function(instance, self.references, self.count, self.values, *self._sizes)
        if status > WARNING:
            pairs = zip(self.names, self.positions, strict=True)
            given = [f"{name} = {self.values[position]!r}" for name, position in pairs]
            what = ", ".join(self.names if function is self._get else given)
            raise self.component.failure(FMICallException(function.__name__, status), what)
