"""The C interface of FMI 2.0 by ctypes alone, and a process of its own for every test of it.

Nothing here knows how a master would call an FMU: any call can be made in any state, with any
arguments. `isolated` runs a test in a forked child, where a crash or a hang of the library is seen
and reported instead of ending all tests.
"""

import functools
import multiprocessing
import signal
import traceback
import zipfile
from collections.abc import Callable, Iterable
from ctypes import (
    CDLL,
    CFUNCTYPE,
    POINTER,
    Structure,
    byref,
    c_char_p,
    c_double,
    c_int,
    c_size_t,
    c_uint,
    c_void_p,
    create_string_buffer,
)
from dataclasses import dataclass
from enum import IntEnum
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp
from typing import Any, NamedTuple, Self
from xml.etree import ElementTree

import pytest

MODELS = ["Pendulum", "Pid", "PidRbf", "IpidRbf", "Source"]

each_model = pytest.mark.parametrize("model", MODELS)


class Status(IntEnum):
    """`fmi2Status`."""

    OK = 0
    WARNING = 1
    DISCARD = 2
    ERROR = 3
    FATAL = 4
    PENDING = 5


OK, WARNING, DISCARD, ERROR, FATAL, PENDING = Status

DO_STEP_STATUS, PENDING_STATUS, LAST_SUCCESSFUL_TIME, TERMINATED = range(4)
"""`fmi2StatusKind`."""

MODEL_EXCHANGE, CO_SIMULATION = range(2)
"""`fmi2Type`."""

# --- the functions of the standard --------------------------------------------------------------

_REAL, _INTEGER, _TEXT, _SIZE, _POINTER = c_double, c_int, c_char_p, c_size_t, c_void_p
_REFERENCES, _TEXTS = POINTER(c_uint), POINTER(c_char_p)
_REALS, _INTEGERS, _STATE = POINTER(c_double), POINTER(c_int), POINTER(c_void_p)

CALLS: dict[str, tuple] = {
    "fmi2SetDebugLogging": (_INTEGER, _SIZE, _TEXTS),
    "fmi2SetupExperiment": (_INTEGER, _REAL, _REAL, _INTEGER, _REAL),
    "fmi2EnterInitializationMode": (),
    "fmi2ExitInitializationMode": (),
    "fmi2Terminate": (),
    "fmi2Reset": (),
    "fmi2GetReal": (_REFERENCES, _SIZE, _REALS),
    "fmi2GetInteger": (_REFERENCES, _SIZE, _INTEGERS),
    "fmi2GetBoolean": (_REFERENCES, _SIZE, _INTEGERS),
    "fmi2GetString": (_REFERENCES, _SIZE, _TEXTS),
    "fmi2SetReal": (_REFERENCES, _SIZE, _REALS),
    "fmi2SetInteger": (_REFERENCES, _SIZE, _INTEGERS),
    "fmi2SetBoolean": (_REFERENCES, _SIZE, _INTEGERS),
    "fmi2SetString": (_REFERENCES, _SIZE, _TEXTS),
    "fmi2GetFMUstate": (_STATE,),
    "fmi2SetFMUstate": (_POINTER,),
    "fmi2FreeFMUstate": (_STATE,),
    "fmi2SerializedFMUstateSize": (_POINTER, POINTER(c_size_t)),
    "fmi2SerializeFMUstate": (_POINTER, _POINTER, _SIZE),
    "fmi2DeSerializeFMUstate": (_POINTER, _SIZE, _STATE),
    "fmi2GetDirectionalDerivative": (_REFERENCES, _SIZE, _REFERENCES, _SIZE, _REALS, _REALS),
    "fmi2EnterEventMode": (),
    "fmi2NewDiscreteStates": (_POINTER,),
    "fmi2EnterContinuousTimeMode": (),
    "fmi2CompletedIntegratorStep": (_INTEGER, _INTEGERS, _INTEGERS),
    "fmi2SetTime": (_REAL,),
    "fmi2SetContinuousStates": (_REALS, _SIZE),
    "fmi2GetDerivatives": (_REALS, _SIZE),
    "fmi2GetEventIndicators": (_REALS, _SIZE),
    "fmi2GetContinuousStates": (_REALS, _SIZE),
    "fmi2GetNominalsOfContinuousStates": (_REALS, _SIZE),
    "fmi2SetRealInputDerivatives": (_REFERENCES, _SIZE, _INTEGERS, _REALS),
    "fmi2GetRealOutputDerivatives": (_REFERENCES, _SIZE, _INTEGERS, _REALS),
    "fmi2DoStep": (_REAL, _REAL, _INTEGER),
    "fmi2CancelStep": (),
    "fmi2GetStatus": (_INTEGER, _INTEGERS),
    "fmi2GetRealStatus": (_INTEGER, _REALS),
    "fmi2GetIntegerStatus": (_INTEGER, _INTEGERS),
    "fmi2GetBooleanStatus": (_INTEGER, _INTEGERS),
    "fmi2GetStringStatus": (_INTEGER, _TEXTS),
}
"""The functions that take an instance and return a status, with their further arguments."""

Logger = CFUNCTYPE(None, c_void_p, c_char_p, c_int, c_char_p, c_char_p, c_char_p)
"""`fmi2CallbackLogger` with one variadic argument, of type `char *`.

On x86-64 and AArch64 Linux it is passed as if the function were not variadic.
"""


class Callbacks(Structure):
    """`fmi2CallbackFunctions`; whoever calls one of the three that stay NULL crashes."""

    _fields_ = (
        ("logger", Logger),
        ("allocate_memory", c_void_p),
        ("free_memory", c_void_p),
        ("step_finished", c_void_p),
        ("environment", c_void_p),
    )


class Library:
    """A loaded FMU binary."""

    def __init__(self, path: Path):
        self.cdll = CDLL(str(path))
        self.functions = {name: self._bind(name, types) for name, types in CALLS.items()}
        self.instantiate = self.cdll.fmi2Instantiate
        self.instantiate.argtypes = (
            c_char_p, c_int, c_char_p, c_char_p, c_void_p, c_int, c_int,
        )  # fmt: skip
        self.instantiate.restype = c_void_p
        self.free_instance = self.cdll.fmi2FreeInstance
        self.free_instance.argtypes, self.free_instance.restype = (c_void_p,), None
        self.version = self.cdll.fmi2GetVersion
        self.types_platform = self.cdll.fmi2GetTypesPlatform
        self.version.restype = self.types_platform.restype = c_char_p

    def _bind(self, name: str, types: tuple) -> Callable[..., int]:
        function = getattr(self.cdll, name)
        function.argtypes, function.restype = (c_void_p, *types), c_int
        return function


# --- the FMU file -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Variable:
    """A scalar variable of the model description; `kind` is Real, Integer or Boolean."""

    name: str
    reference: int
    kind: str
    causality: str
    variability: str
    start: float | int | None
    minimum: float | None
    maximum: float | None
    items: int

    @classmethod
    def parse(cls, xml: ElementTree.Element, sizes: dict[str, int]) -> Self:
        """Read a `ScalarVariable`; `sizes` are the numbers of items of enumeration types."""
        (element,) = (child for child in xml if child.tag != "Annotations")
        enumeration = element.tag == "Enumeration"
        number = float if element.tag == "Real" else _whole
        limits = [element.get(key) for key in ("start", "min", "max")]
        start, minimum, maximum = (None if text is None else number(text) for text in limits)
        return cls(
            xml.get("name"), int(xml.get("valueReference")),
            "Integer" if enumeration else element.tag,
            xml.get("causality"), xml.get("variability"), start, minimum, maximum,
            sizes[element.get("declaredType")] if enumeration else 0,
        )  # fmt: skip

    @property
    def c_type(self) -> type:
        """The C type of its value."""
        return c_double if self.kind == "Real" else c_int

    def settable(self, *, running: bool) -> bool:
        """Tell whether the host may set it; `running`: the initialization is over."""
        fixed = self.causality == "parameter" and self.variability == "fixed"
        return self.causality != "output" and not (running and fixed)

    def other_value(self) -> float | int:
        """Return a value that is allowed, and is not the start value."""
        if self.kind == "Real":
            return self.start * 1.25 if self.start else 0.125
        return 1 - self.start if self.kind == "Boolean" else self.start % self.items + 1


def _whole(text: str) -> int:
    return {"true": 1, "false": 0}.get(text) if text in ("true", "false") else int(text)


@dataclass(frozen=True)
class Fmu:
    """An unpacked FMU: its library, and what its model description says."""

    model: str
    binary: Path
    guid: bytes
    flags: dict[str, str]
    categories: list[str]
    variables: dict[str, Variable]

    def of(self, kind: str, causality: str | None = None) -> list[Variable]:
        """Return the variables of a type, and of a causality if one is given."""
        return [
            v for v in self.variables.values()
            if v.kind == kind and causality in (None, v.causality)
        ]  # fmt: skip

    def flag(self, name: str) -> bool:
        """Tell whether a capability flag is true."""
        return self.flags.get(name) == "true"

    @functools.cached_property
    def library(self) -> Library:
        """The library, loaded."""
        return Library(self.binary)


_unpacked = TemporaryDirectory(prefix="c-interface-")


@functools.cache
def unpack(fmus: Path, model: str, platform: str = "linux64") -> Fmu:
    """Unpack an FMU of the folder `fmus` and read its model description."""
    extension = "dll" if platform.startswith("win") else "so"
    with zipfile.ZipFile(fmus / f"{model}.fmu") as package:
        binary = package.extract(
            f"binaries/{platform}/{model}.{extension}", mkdtemp(dir=_unpacked.name)
        )
        xml = ElementTree.fromstring(package.read("modelDescription.xml"))
    sizes = {
        kind.get("name"): len(kind.findall("Enumeration/Item"))
        for kind in xml.iter("SimpleType")
    }  # fmt: skip
    variables = [Variable.parse(v, sizes) for v in xml.iter("ScalarVariable")]
    return Fmu(
        model,
        Path(binary),
        xml.get("guid").encode(),
        dict(xml.find("CoSimulation").attrib),
        [category.get("name") for category in xml.iter("Category")],
        {v.name: v for v in variables},
    )


# --- an instance --------------------------------------------------------------------------------


class Message(NamedTuple):
    """What the logger was called with."""

    environment: int | None
    instance: bytes
    status: int
    category: bytes
    format: bytes
    text: bytes

    def __str__(self) -> str:
        return self.text.decode()


class Slave:
    """An instance; its methods `fmi2...` are those of the standard, and return the status.

    Parameters
    ----------
    fmu
        The unpacked FMU.
    name, guid, kind, resource, debug
        Arguments of `fmi2Instantiate`; `guid` None is that of the FMU.
    library
        Another library than that of the FMU.
    """

    environment = 4711

    def __init__(
        self,
        fmu: Fmu,
        name: bytes | None = b"slave",
        *,
        guid: bytes | None = None,
        kind: int = CO_SIMULATION,
        resource: bytes | None = None,
        debug: bool = False,
        library: Library | None = None,
    ):
        self.fmu, self.library = fmu, library or fmu.library
        self.messages: list[Message] = []
        self._callbacks = Callbacks(Logger(self._log), environment=self.environment)
        self.component = self.library.instantiate(
            name, kind, fmu.guid if guid is None else guid, resource,
            byref(self._callbacks), 0, debug,
        )  # fmt: skip

    def _log(self, *arguments) -> None:
        self.messages.append(Message(*arguments))

    def __getattr__(self, name: str) -> Callable[..., int]:
        if name not in CALLS:
            raise AttributeError(name)
        return functools.partial(self.library.functions[name], self.component)

    @property
    def told(self) -> str:
        """The newest message."""
        assert self.messages, "nothing was logged"
        return str(self.messages[-1])

    def free(self) -> None:
        """Free the instance."""
        self.library.free_instance(self.component)
        self.component = None

    def start(self, time: float = 0.0, stop: float | None = None) -> Self:
        """Go to "step complete" at `time` [s]."""
        defined = stop is not None
        assert self.fmi2SetupExperiment(0, 0.0, time, defined, stop or 0.0) == OK
        assert self.fmi2EnterInitializationMode() == OK
        assert self.fmi2ExitInitializationMode() == OK
        return self

    def step(self, time: float, step: float) -> int:
        """Step from `time` by `step` [s]."""
        return self.fmi2DoStep(time, step, 1)

    # --- values

    def set(self, name: str, value: float) -> int:
        """Set a variable by its name."""
        variable = self.fmu.variables[name]
        setter = getattr(self, f"fmi2Set{variable.kind}")
        return setter(references([variable]), 1, (variable.c_type * 1)(value))

    def put(self, **values: float) -> Self:
        """Set variables, whose names have no dots, and see that it works."""
        return self.put_all(values)

    def put_all(self, values: dict[str, float]) -> Self:
        """Set variables by name, and see that it works."""
        for name, value in values.items():
            assert self.set(name, value) == OK, self.told
        return self

    def get(self, name: str) -> float | int:
        """Get a variable by its name."""
        (value,) = self.get_all([self.fmu.variables[name]])
        return value

    def get_all(self, variables: Iterable[Variable]) -> list[float | int]:
        """Get variables of one type in one call."""
        variables = list(variables)
        if not variables:
            return []
        values = (variables[0].c_type * len(variables))()
        getter = getattr(self, f"fmi2Get{variables[0].kind}")
        assert getter(references(variables), len(variables), values) == OK, self.told
        return list(values)

    def outputs(self) -> list[float]:
        """Get all outputs."""
        return self.get_all(self.fmu.of("Real", "output"))

    def everything(self) -> dict[str, str]:
        """Get all variables, in a form that can be compared bit for bit."""
        found = {}
        for kind in ("Real", "Integer", "Boolean"):
            variables = self.fmu.of(kind)
            values = self.get_all(variables)
            found |= {v.name: float(x).hex() for v, x in zip(variables, values, strict=True)}
        return found

    # --- FMU states

    def save(self) -> c_void_p:
        """Return a new FMU state."""
        state = c_void_p()
        assert self.fmi2GetFMUstate(byref(state)) == OK, self.told
        assert state.value
        return state

    def drop(self, state: c_void_p) -> None:
        """Free an FMU state."""
        assert self.fmi2FreeFMUstate(byref(state)) == OK
        assert state.value is None

    def serialize(self, state: c_void_p) -> bytes:
        """Return an FMU state as bytes."""
        size = c_size_t()
        assert self.fmi2SerializedFMUstateSize(state, byref(size)) == OK, self.told
        buffer = create_string_buffer(size.value)
        assert self.fmi2SerializeFMUstate(state, buffer, size) == OK, self.told
        return buffer.raw

    def snapshot(self) -> bytes:
        """Return the present state as bytes."""
        state = self.save()
        serialized = self.serialize(state)
        self.drop(state)
        return serialized

    def deserialize(self, serialized: bytes, state: c_void_p | None = None) -> int:
        """Make an FMU state of bytes, in `state` if it is wanted afterwards."""
        unwanted = state is None
        state = c_void_p() if unwanted else state
        status = self.fmi2DeSerializeFMUstate(serialized, len(serialized), byref(state))
        if unwanted and state.value:
            self.drop(state)
        return status

    def resume(self, serialized: bytes) -> Self:
        """Go to the state that the bytes hold."""
        state = c_void_p()
        assert self.deserialize(serialized, state) == OK, self.told
        assert self.fmi2SetFMUstate(state) == OK, self.told
        self.drop(state)
        return self


def references(variables: Iterable[Variable]):
    """Return the value references of variables as a C array."""
    numbers = [v.reference for v in variables]
    return (c_uint * len(numbers))(*numbers)


def reals(*values: float):
    """Return numbers as a C array."""
    return (c_double * len(values))(*values)


def integers(*values: int):
    """Return whole numbers as a C array."""
    return (c_int * len(values))(*values)


def texts(*values: bytes | None):
    """Return texts as a C array."""
    return (c_char_p * len(values))(*values)


# --- a process for every test -------------------------------------------------------------------


def isolated(test: Callable | None = None, *, timeout: float = 60.0):
    """Run a test in a child process; the test fails if that crashes, or takes `timeout` [s]."""
    if test is None:
        return functools.partial(isolated, timeout=timeout)

    @functools.wraps(test)
    def run(*args, **kwargs):
        in_child(functools.partial(test, *args, **kwargs), timeout)

    return run


def in_child(work: Callable[[], Any], timeout: float = 60.0) -> Any:
    """Return what `work` returns in a forked child process."""
    context = multiprocessing.get_context("fork")
    receiver, sender = context.Pipe(duplex=False)
    child = context.Process(target=_report, args=(work, sender))
    child.start()
    sender.close()
    try:
        if not receiver.poll(timeout):
            pytest.fail(f"hangs: no end after {timeout} s", pytrace=False)
        result, failure = receiver.recv()
    except EOFError:
        child.join()
        pytest.fail(f"crashed: {_cause(child.exitcode)}", pytrace=False)
    finally:
        child.kill()
        child.join()
    if failure is not None:
        pytest.fail(failure, pytrace=False)
    return result


def _report(work: Callable[[], Any], sender: Connection) -> None:
    """Send what `work` returns, and how it failed."""
    try:
        sender.send((work(), None))
    except BaseException:
        sender.send((None, traceback.format_exc()))


def _cause(code: int) -> str:
    return signal.Signals(-code).name if code < 0 else f"exit code {code}"
