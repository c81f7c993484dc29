"""Every argument of every call: what is wrong is refused with a message, and changes nothing."""

import math
import re
from ctypes import byref, c_size_t, c_uint, c_void_p, create_string_buffer

import pytest

from slave import (
    CO_SIMULATION,
    ERROR,
    MODEL_EXCHANGE,
    MODELS,
    OK,
    Slave,
    Variable,
    each_model,
    integers,
    isolated,
    reals,
    references,
    texts,
    unpack,
)

KINDS = ["Real", "Integer", "Boolean", "String"]

UNKNOWN = 10**6
"""No model has so many variables."""

# --- what the messages say ----------------------------------------------------------------------

NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*(?:e[-+]?\d+)?|inf|nan)", re.IGNORECASE)


def numbers(message: str) -> list[float]:
    """Return all numbers in a message; NaN as None."""
    found = [float(text) for text in NUMBER.findall(message)]
    return [None if math.isnan(number) else number for number in found]


def assert_told(slave: Slave, variable: Variable, value: float | None = None) -> None:
    """Check that the newest message names a variable, and the value that was refused."""
    name = re.escape(variable.name)
    assert re.search(rf"(?<![\w.]){name}(?![\w.\[])", slave.told), slave.told
    if value is not None:
        assert (None if math.isnan(value) else value) in numbers(slave.told), slave.told
    message = slave.messages[-1]
    assert (message.category, message.status) == (b"logStatusError", ERROR)


class Unchanged:
    """Checks that its body leaves an instance as it is, and that every call in it is told."""

    def __init__(self, slave: Slave):
        self.slave = slave

    def __enter__(self) -> None:
        self.before, self.logged = self.slave.snapshot(), len(self.slave.messages)

    def __exit__(self, failure, *_) -> None:
        if failure is None:
            assert self.slave.snapshot() == self.before
            assert len(self.slave.messages) > self.logged, "nothing was told"


def initializing(fmus, model: str) -> Slave:
    """Return an instance in initialization mode, whose outputs are computed."""
    slave = Slave(unpack(fmus, model))
    assert slave.fmi2SetupExperiment(0, 0.0, 0.0, 0, 0.0) == OK
    assert slave.fmi2EnterInitializationMode() == OK
    slave.outputs()
    return slave


def running(fmus, model: str) -> Slave:
    """Return an instance that has taken a step."""
    slave = Slave(unpack(fmus, model)).start()
    assert slave.step(0.0, 0.001) == OK
    return slave


PHASES = {"instantiated": lambda fmus, model: Slave(unpack(fmus, model)),
          "initialization": initializing, "running": running}  # fmt: skip

# --- single values ------------------------------------------------------------------------------


@each_model
@pytest.mark.parametrize("phase", PHASES)
@isolated
def test_values_come_back_as_they_were_set(fmus, model, phase):
    slave = PHASES[phase](fmus, model)
    late = phase == "running"
    variables = [v for v in slave.fmu.variables.values() if v.settable(running=late)]
    slave.put_all({v.name: v.other_value() for v in variables})
    if phase == "instantiated":
        slave.start()
    for variable in variables:
        assert slave.get(variable.name) == variable.other_value(), variable.name


@each_model
@isolated
def test_start_values_are_those_of_the_model_description(fmus, model):
    slave = initializing(fmus, model)
    for variable in slave.fmu.variables.values():
        if variable.start is not None:
            assert slave.get(variable.name) == variable.start, variable.name


@each_model
@isolated
def test_bounds_belong_to_what_is_allowed(fmus, model):
    for variable in unpack(fmus, model).variables.values():
        for value in (variable.minimum, variable.maximum):
            if value is not None and variable.causality != "output":
                slave = initializing(fmus, model)
                assert slave.set(variable.name, value) == OK, slave.told


def outside(variable: Variable) -> list[float]:
    """Return values that a variable does not take."""
    if variable.kind == "Boolean":
        return [2, -1, 2**31 - 1, -(2**31)]
    if variable.items:
        return [0, variable.items + 1, -1, 2**31 - 1, -(2**31)]
    bounds = []
    if variable.minimum is not None:
        bounds += [math.nextafter(variable.minimum, -math.inf), variable.minimum - 1]
    if variable.maximum is not None:
        bounds += [math.nextafter(variable.maximum, math.inf), 2 * variable.maximum + 1]
    return [*bounds, math.nan, math.inf, -math.inf]


@each_model
@pytest.mark.parametrize("phase", PHASES)
@isolated
def test_values_that_are_not_allowed_are_refused_by_name(fmus, model, phase):
    slave = PHASES[phase](fmus, model)
    for variable in slave.fmu.variables.values():
        if variable.settable(running=phase == "running"):
            for value in outside(variable):
                with Unchanged(slave):
                    assert slave.set(variable.name, value) == ERROR, (variable.name, value)
                assert_told(slave, variable, value)
                assert_expected(slave, variable)


def assert_expected(slave: Slave, variable: Variable) -> None:
    """Check that the newest message says what is expected: the bounds, or the items."""
    bounds = {variable.minimum, variable.maximum} - {None}
    if variable.kind == "Boolean":
        bounds = {0, 1}
    if variable.items:
        bounds = set(range(1, variable.items + 1))
    assert bounds <= set(numbers(slave.told)), slave.told


@each_model
@pytest.mark.parametrize("phase", PHASES)
@isolated
def test_outputs_cannot_be_set(fmus, model, phase):
    slave = PHASES[phase](fmus, model)
    for variable in slave.fmu.of("Real", "output"):
        with Unchanged(slave):
            assert slave.set(variable.name, 0.0) == ERROR
        assert_told(slave, variable)


@each_model
@isolated
def test_fixed_parameters_cannot_be_set_once_it_runs(fmus, model):
    slave = running(fmus, model)
    for variable in slave.fmu.variables.values():
        if variable.variability == "fixed":
            with Unchanged(slave):
                assert slave.set(variable.name, variable.other_value()) == ERROR, variable.name
            assert_told(slave, variable)


@each_model
@isolated
def test_a_tunable_parameter_counts_from_the_next_step_on(fmus, model):
    """Half the limit of the force is half the force, where the force is limited."""
    if model not in ("Pid", "PidRbf", "IpidRbf"):
        return
    slave = running(fmus, model).put(r=1.0)
    assert slave.step(0.001, 0.001) == OK
    assert slave.get("u") == 100.0
    slave.put(u_max=50.0)
    assert slave.step(0.002, 0.001) == OK
    assert slave.get("u") == 50.0


# --- references and types -----------------------------------------------------------------------

WRONG = [
    (model, action, kind)
    for model in MODELS for action in ("Get", "Set") for kind in KINDS
]  # fmt: skip


def buffer(kind: str, count: int):
    """Return values of a type as a C array: zeros and empty texts."""
    make = {"Real": reals, "String": texts}.get(kind, integers)
    return make(*[b"" if kind == "String" else 0] * count)


@pytest.mark.parametrize(("model", "action", "kind"), WRONG)
@isolated
def test_an_unknown_reference_is_refused(fmus, model, action, kind):
    slave = initializing(fmus, model)
    for reference in (len(slave.fmu.variables), UNKNOWN, 2**31, 2**32 - 1):
        with Unchanged(slave):
            call = getattr(slave, f"fmi2{action}{kind}")
            assert call((c_uint * 1)(reference), 1, buffer(kind, 1)) == ERROR
        assert reference in numbers(slave.told)


@pytest.mark.parametrize(("model", "action", "kind"), WRONG)
@isolated
def test_a_variable_of_another_type_is_refused_by_name(fmus, model, action, kind):
    slave = initializing(fmus, model)
    for variable in slave.fmu.variables.values():
        if variable.kind != kind:
            with Unchanged(slave):
                call = getattr(slave, f"fmi2{action}{kind}")
                assert call(references([variable]), 1, buffer(kind, 1)) == ERROR
            assert_told(slave, variable)
            assert kind in slave.told


@pytest.mark.parametrize(("model", "action", "kind"), WRONG)
@isolated
def test_null_is_refused_unless_nothing_is_asked_for(fmus, model, action, kind):
    slave = initializing(fmus, model)
    variables = slave.fmu.of(kind) or list(slave.fmu.variables.values())
    some, values = references(variables), buffer(kind, len(variables))
    call = getattr(slave, f"fmi2{action}{kind}")
    for arguments in [(None, 1, values), (some, 1, None), (None, 3, None)]:
        with Unchanged(slave):
            assert call(*arguments) == ERROR
        assert f"fmi2{action}{kind}" in slave.told
    for arguments in [(None, 0, None), (some, 0, None), (None, 0, values), (some, 0, values)]:
        assert call(*arguments) == OK


# --- several variables: all or nothing ----------------------------------------------------------


@each_model
@pytest.mark.parametrize("phase", PHASES)
@isolated
def test_one_bad_value_keeps_all_from_being_set(fmus, model, phase):
    slave = PHASES[phase](fmus, model)
    late = phase == "running"
    good = [v for v in slave.fmu.of("Real") if v.settable(running=late)]
    for bad, value in bad_companions(slave, good):
        for variables in ([*good, bad], [bad, *good], [*good, bad, *good]):
            values = [value if v is bad else v.other_value() for v in variables]
            arguments = (references(variables), len(values), reals(*values))
            with Unchanged(slave):
                assert slave.fmi2SetReal(*arguments) == ERROR


def bad_companions(slave: Slave, good: list[Variable]) -> list[tuple[Variable, float]]:
    """Return variables and values that cannot be set, of every sort."""
    unknown = Variable("?", UNKNOWN, "Real", "input", "continuous", 0.0, None, None, 0)
    others = [v for v in slave.fmu.variables.values() if v.kind != "Real"]
    return [
        *[(v, 0.0) for v in slave.fmu.of("Real", "output")[:1]],
        *[(v, 1.0) for v in others[:1]],
        *[(v, math.nan) for v in good[-1:]],
        (unknown, 0.0),
    ]


@each_model
@isolated
def test_one_bad_reference_keeps_all_from_being_read(fmus, model):
    slave = initializing(fmus, model)
    good = [v.reference for v in slave.fmu.of("Real")]
    asked = (c_uint * (len(good) + 1))(*good, UNKNOWN)
    values = reals(*[-77.0] * len(asked))
    with Unchanged(slave):
        assert slave.fmi2GetReal(asked, len(asked), values) == ERROR
    assert set(values) == {-77.0}


@each_model
@isolated
def test_the_last_of_several_values_for_one_variable_counts(fmus, model):
    slave = initializing(fmus, model)
    variable = next(v for v in slave.fmu.of("Real") if v.settable(running=False))
    values = reals(variable.other_value(), variable.start, variable.other_value())
    assert slave.fmi2SetReal(references([variable] * 3), 3, values) == OK
    assert slave.get_all([variable] * 3) == [variable.other_value()] * 3


# --- what belongs to FMU states and logging -----------------------------------------------------


@each_model
@isolated
def test_null_among_the_arguments_of_fmu_states_is_refused(fmus, model):
    slave = running(fmus, model)
    state, size = slave.save(), c_size_t(5)
    room = create_string_buffer(10_000)
    for status in (
        slave.fmi2GetFMUstate(None),
        slave.fmi2SetFMUstate(None),
        slave.fmi2SerializedFMUstateSize(None, byref(size)),
        slave.fmi2SerializedFMUstateSize(state, None),
        slave.fmi2SerializeFMUstate(None, room, len(room)),
        slave.fmi2SerializeFMUstate(state, None, len(room)),
        slave.fmi2DeSerializeFMUstate(None, 100, byref(c_void_p())),
        slave.fmi2DeSerializeFMUstate(slave.serialize(state), len(slave.serialize(state)), None),
        slave.fmi2DeSerializeFMUstate(None, 0, byref(c_void_p())),
        slave.fmi2DeSerializeFMUstate(room, 0, byref(c_void_p())),
    ):
        assert status == ERROR
    assert size.value == 5
    assert room.raw == bytes(10_000)


@each_model
@isolated
def test_a_state_that_is_not_there_can_be_freed(fmus, model):
    slave = running(fmus, model)
    assert slave.fmi2FreeFMUstate(None) == OK
    assert slave.fmi2FreeFMUstate(byref(c_void_p())) == OK
    state = slave.save()
    slave.drop(state)
    slave.drop(state)


@each_model
@isolated
def test_null_among_log_categories_is_refused(fmus, model):
    slave = Slave(unpack(fmus, model))
    for count, names in [(1, None), (2, texts(b"logAll", None)), (1, texts(None))]:
        with Unchanged(slave):
            assert slave.fmi2SetDebugLogging(1, count, names) == ERROR
    assert slave.fmi2SetDebugLogging(1, 0, None) == OK


# --- instantiation ------------------------------------------------------------------------------

REFUSED = {
    "no name": {"name": None},
    "an empty name": {"name": b""},
    "a name that is not UTF-8": {"name": b"pend\xfful\xc3"},
    "an empty GUID": {"guid": b""},
    "another GUID": {"guid": b"{00000000-0000-0000-0000-000000000000}"},
    "a GUID that is not UTF-8": {"guid": b"\xff\xfe"},
    "model exchange": {"kind": MODEL_EXCHANGE},
    "no type of the standard": {"kind": 7},
}


@each_model
@pytest.mark.parametrize("case", REFUSED)
@isolated
def test_an_impossible_instance_is_refused_with_a_reason(fmus, model, case):
    slave = Slave(unpack(fmus, model), **REFUSED[case])
    assert slave.component is None
    (message,) = slave.messages
    assert (message.status, message.category) == (ERROR, b"logStatusError")
    assert message.environment == Slave.environment
    assert message.instance is not None
    assert "fmi2Instantiate" in str(message)


@each_model
@isolated
def test_an_instance_without_guid_is_refused(fmus, model):
    library = unpack(fmus, model).library
    assert library.instantiate(b"x", CO_SIMULATION, None, None, None, 0, 0) is None


@each_model
@isolated
def test_the_guid_of_another_model_of_the_tree_gives_no_wrong_instance(fmus, model):
    """One binary may hold several models; then the GUID says which, and its variables follow."""
    for other in set(MODELS) - {model}:
        foreign = unpack(fmus, other)
        slave = Slave(foreign, library=unpack(fmus, model).library)
        if slave.component is not None:
            slave.start()
            assert len(slave.everything()) == len(foreign.variables)


RESOURCES = [
    None, b"", b"file:///", b"file:////tmp", b"file://localhost/tmp", b"not a URI \xff%s%n",
    b"https://example.org/%20", b"x" * 100_000,
]  # fmt: skip


@each_model
@pytest.mark.parametrize("resource", RESOURCES, ids=range(len(RESOURCES)))
@isolated
def test_the_resource_location_does_not_matter(fmus, model, resource):
    slave = Slave(unpack(fmus, model), resource=resource).start()
    assert slave.step(0.0, 0.001) == OK
    assert slave.messages == []


@each_model
@isolated
def test_a_host_without_callbacks_is_served(fmus, model):
    fmu = unpack(fmus, model)
    call = fmu.library.functions
    c = fmu.library.instantiate(b"x", CO_SIMULATION, fmu.guid, None, None, 1, 1)
    assert c
    assert call["fmi2DoStep"](c, 0.0, 0.001, 1) == ERROR
    assert call["fmi2SetDebugLogging"](c, 1, 1, texts(b"nonsense")) == ERROR
    assert call["fmi2EnterInitializationMode"](c) == OK
    assert call["fmi2ExitInitializationMode"](c) == OK
    assert call["fmi2DoStep"](c, 0.0, 0.001, 1) == OK
    fmu.library.free_instance(c)
