"""The calls of FMI 2.0 and FMI 3.0 in one form, for both types of FMU, on top of FMPy."""

import os
from collections.abc import Sequence
from ctypes import byref, c_bool, c_double, c_float, c_int, c_uint

from fmpy import calloc, fmi3, free
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import (
    FMU2Model,
    FMU2Slave,
    fmi2CallbackAllocateMemoryTYPE,
    fmi2CallbackFreeMemoryTYPE,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
)
from fmpy.logging import addLoggerProxy
from fmpy.model_description import ModelDescription

# --- log messages -------------------------------------------------------------------------------

messages: dict[str, str] = {}
"""The newest message of every instance, which explains the status of a failed call."""


def _keep(instance: str, message: bytes) -> None:
    messages[instance] = message.decode(errors="replace")


def _callbacks() -> fmi2CallbackFunctions:
    """Return the callbacks for FMUs: our logger and the C library's memory functions."""

    def log(_environment, instance: bytes, _status, _category, message: bytes) -> None:
        _keep(instance.decode(), message)

    callbacks = fmi2CallbackFunctions()
    callbacks.logger = fmi2CallbackLoggerTYPE(log)
    callbacks.allocateMemory = fmi2CallbackAllocateMemoryTYPE(calloc)
    callbacks.freeMemory = fmi2CallbackFreeMemoryTYPE(free)
    addLoggerProxy(byref(callbacks))
    return callbacks


# Shared by all instances: FMPy's proxy, which formats variadic messages, supports only one logger.
_CALLBACKS = _callbacks()


# --- instances ----------------------------------------------------------------------------------


class Fmi2:
    """An instance of an FMI 2.0 FMU; failed calls raise FMPy's FMICallException.

    Parameters
    ----------
    description
        Its model description.
    folder
        Where it is unzipped.
    name
        The name of the instance.
    kind
        "coSimulation" or "modelExchange".
    """

    REAL = "Real"
    CLASSES = {"coSimulation": FMU2Slave, "modelExchange": FMU2Model}  # noqa: RUF012

    def __init__(
        self, description: ModelDescription, folder: str | os.PathLike, name: str, kind: str
    ):
        self.fmu = self.CLASSES[kind](
            guid=description.guid,
            unzipDirectory=folder,
            modelIdentifier=getattr(description, kind).modelIdentifier,
            instanceName=name,
        )
        self.setters = self._setters()

    def _setters(self) -> dict:
        """Return the function that sets variables of a type, and its C type."""
        return {
            "Real": (self.fmu.fmi2SetReal, c_double),
            "Integer": (self.fmu.fmi2SetInteger, c_int),
            "Enumeration": (self.fmu.fmi2SetInteger, c_int),
            "Boolean": (self.fmu.fmi2SetBoolean, c_int),
        }

    def instantiate(self) -> None:
        """Instantiate with logging."""
        self.fmu.instantiate(callbacks=_CALLBACKS, loggingOn=True)

    def free(self) -> None:
        """Free the instance, but keep the library."""
        self.fmu.fmi2FreeInstance(self.fmu.component)

    def initialize(self, time: float) -> None:
        """Go through the initialization mode at `time` [s]."""
        self.fmu.setupExperiment(startTime=time)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()

    def set(self, kind: str, reference: int, numbers: Sequence[float]) -> None:
        """Set a variable of the type `kind`; an array has more than one number."""
        function, c_type = self.setters[kind]
        values = (c_type * len(numbers))(*numbers)
        function(self.fmu.component, (c_uint * 1)(reference), 1, values)

    def get_reals(self, references, count: int, values, _size: int) -> None:
        """Read `count` variables with `size` elements; `values` is a pointer to doubles."""
        self.fmu.fmi2GetReal(self.fmu.component, references, count, values)

    def set_reals(self, references, count: int, values, _size: int) -> None:
        """Write `count` variables with `size` elements."""
        self.fmu.fmi2SetReal(self.fmu.component, references, count, values)

    def step(self, time: float, step: float) -> None:
        """Step from `time` to `time + step` [s]."""
        self.fmu.fmi2DoStep(self.fmu.component, time, step, True)

    def update_discrete_states(self) -> tuple:
        """Update the discrete states in the event mode, and return the values of the event info."""
        return self.fmu.newDiscreteStates()

    def get_derivatives(self, values, count: int) -> None:
        """Read the derivatives of the continuous states."""
        self.fmu.getDerivatives(values, count)


class Fmi3(Fmi2):
    """An instance of an FMI 3.0 FMU, as `Fmi2`."""

    REAL = "Float64"
    CLASSES = {"coSimulation": fmi3.FMU3Slave, "modelExchange": fmi3.FMU3Model}  # noqa: RUF012

    def _setters(self) -> dict:
        whole = [f"{sign}Int{bits}" for sign in ("", "U") for bits in (8, 16, 32, 64)]
        c_types = {name: getattr(fmi3, f"fmi3{name}") for name in whole}
        c_types |= {"Float64": c_double, "Float32": c_float, "Boolean": c_bool}
        setters = {
            name: (getattr(self.fmu, f"fmi3Set{name}"), c_type) for name, c_type in c_types.items()
        }
        return setters | {"Enumeration": setters["Int64"]}

    def instantiate(self) -> None:
        """Instantiate with logging."""
        name = self.fmu.instanceName

        def log(_environment, _status, _category, message: bytes) -> None:
            _keep(name, message)

        self.fmu.instantiate(loggingOn=True, logMessage=log)
        self._flags = [c_bool(), c_bool(), c_bool(), c_double()]
        self._pointers = [byref(flag) for flag in self._flags]

    def free(self) -> None:
        """Free the instance, but keep the library."""
        self.fmu.fmi3FreeInstance(self.fmu.component)

    def initialize(self, time: float) -> None:
        """Go through the initialization mode at `time` [s]."""
        self.fmu.enterInitializationMode(startTime=time)
        self.fmu.exitInitializationMode()

    def set(self, kind: str, reference: int, numbers: Sequence[float]) -> None:
        """Set a variable of the type `kind`; an array has more than one number."""
        function, c_type = self.setters[kind]
        values = (c_type * len(numbers))(*numbers)
        function(self.fmu.component, (c_uint * 1)(reference), 1, values, len(values))

    def get_reals(self, references, count: int, values, size: int) -> None:
        """Read `count` variables with `size` elements; `values` is a pointer to doubles."""
        self.fmu.fmi3GetFloat64(self.fmu.component, references, count, values, size)

    def set_reals(self, references, count: int, values, size: int) -> None:
        """Write `count` variables with `size` elements."""
        self.fmu.fmi3SetFloat64(self.fmu.component, references, count, values, size)

    def step(self, time: float, step: float) -> None:
        """Step from `time` to `time + step` [s]."""
        self.fmu.fmi3DoStep(self.fmu.component, time, step, True, *self._pointers)
        if self._flags[1].value:
            raise FMICallException("fmi3DoStep with terminateSimulation", 0)

    def update_discrete_states(self) -> tuple:
        """Update the discrete states in the event mode, and return the values of the event info."""
        return self.fmu.updateDiscreteStates()

    def get_derivatives(self, values, count: int) -> None:
        """Read the derivatives of the continuous states."""
        self.fmu.getContinuousStateDerivatives(values, count)


VERSIONS = {"2.0": Fmi2, "3.0": Fmi3}
"""The class of each version of FMI."""
