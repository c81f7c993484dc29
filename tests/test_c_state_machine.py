"""The table of allowed calls of FMI 2.0.4, section 4.2.4, cell by cell, for every FMU."""

import math
from ctypes import byref, c_char_p, c_int, c_size_t, c_void_p, create_string_buffer

import pytest

from slave import (
    CALLS,
    DISCARD,
    DO_STEP_STATUS,
    ERROR,
    LAST_SUCCESSFUL_TIME,
    MODELS,
    OK,
    PENDING_STATUS,
    TERMINATED,
    WARNING,
    Slave,
    each_model,
    integers,
    isolated,
    reals,
    references,
    texts,
    unpack,
)

# --- the states, and how to get there -----------------------------------------------------------

STATES = [
    "instantiated", "initialization mode", "step complete", "step failed", "terminated", "error",
]  # fmt: skip

H = 0.001
"""Communication step [s]; the states from "step complete" on are reached by one such step."""

SAMPLED = {"ts": 1e-6}
ENDLESS = 1000.0
"""With `ts` = 1e-6, a step [s] of more than 1e8 samples."""

DIVERGES = {
    "Pendulum": ({"theta0": 0.1}, {}, 1000.0),
    "Pid": ({}, {"r": 1.7e308}, H),
    "PidRbf": ({}, {"r": 1.7e308}, H),
    "IpidRbf": ({}, {"r": 1.7e308}, H),
    "Source": ({"signal": 2, "frequency": 1e6}, {}, 1e303),
}
"""Parameters, inputs, and a step [s] whose result no number holds: exp(5.3 h), kp r, 2 pi f h."""


def discards(model: str) -> dict[str, float]:
    """Return the parameters with which a step of `ENDLESS` is discarded."""
    return {**SAMPLED, "model": 1} if model == "Pendulum" else SAMPLED


def bring(slave: Slave, state: str) -> Slave:
    """Bring a new instance to a state."""
    model = slave.fmu.model
    if state == "instantiated":
        return slave
    if state == "initialization mode":
        assert slave.fmi2SetupExperiment(0, 0.0, 0.0, 0, 0.0) == OK
        assert slave.fmi2EnterInitializationMode() == OK
        return slave
    parameters, inputs, step = DIVERGES[model]
    if state == "step failed":
        parameters, inputs, step = discards(model), {}, ENDLESS
    slave.put_all(parameters if state in ("step failed", "error") else {}).start()
    assert slave.step(0.0, H) == OK
    if state in ("step failed", "error"):
        slave.put_all(inputs)
        assert slave.step(H, step) == (DISCARD if state == "step failed" else ERROR)
    if state == "terminated":
        assert slave.fmi2Terminate() == OK
    return slave


# A source takes no samples: no step of it is too long.
REACHABLE = [(m, s) for m in MODELS for s in STATES if (m, s) != ("Source", "step failed")]

# --- the table ----------------------------------------------------------------------------------

_EVERYWHERE = set(STATES)
_START = {"instantiated"}
_READ = {"initialization mode", "step complete", "step failed", "terminated", "error"}
_WRITE = {"instantiated", "initialization mode", "step complete"}
_AFTER_STEP = {"step complete", "step failed", "terminated"}

ALLOWED = {
    "fmi2SetDebugLogging": _EVERYWHERE,
    "fmi2SetupExperiment": _START,
    "fmi2EnterInitializationMode": _START,
    "fmi2ExitInitializationMode": {"initialization mode"},
    "fmi2Terminate": {"step complete", "step failed"},
    "fmi2Reset": _EVERYWHERE,
    "fmi2GetReal": _READ,
    "fmi2GetInteger": _READ,
    "fmi2GetBoolean": _READ,
    "fmi2GetString": _READ,
    "fmi2SetReal": _WRITE,
    "fmi2SetInteger": _WRITE,
    "fmi2SetBoolean": _WRITE,
    "fmi2SetString": _WRITE,
    "fmi2GetFMUstate": _EVERYWHERE,
    "fmi2SetFMUstate": _EVERYWHERE,
    "fmi2FreeFMUstate": _EVERYWHERE,
    "fmi2SerializedFMUstateSize": _EVERYWHERE,
    "fmi2SerializeFMUstate": _EVERYWHERE,
    "fmi2DeSerializeFMUstate": _EVERYWHERE,
    "fmi2GetDirectionalDerivative": _READ,
    "fmi2SetRealInputDerivatives": _WRITE,
    "fmi2DoStep": {"step complete"},
    "fmi2GetRealStatus": _AFTER_STEP,
    "fmi2GetBooleanStatus": _AFTER_STEP,
}
"""Calls, and the states in which they are allowed; what is not listed is allowed in none."""

PENDULUM_ONLY = {"fmi2GetDirectionalDerivative", "fmi2SetRealInputDerivatives"}


def is_allowed(model: str, call: str, state: str) -> bool:
    """Tell what the table says."""
    if call in PENDULUM_ONLY and model != "Pendulum":
        return False
    return state in ALLOWED.get(call, ())


def state_arguments(slave: Slave, call: str) -> tuple:
    """Return valid arguments for the functions around FMU states."""
    state = slave.save()
    serialized = slave.serialize(state)
    return {
        "fmi2GetFMUstate": (byref(c_void_p()),),
        "fmi2SetFMUstate": (state,),
        "fmi2FreeFMUstate": (byref(state),),
        "fmi2SerializedFMUstateSize": (state, byref(c_size_t())),
        "fmi2SerializeFMUstate": (
            state, create_string_buffer(len(serialized)), len(serialized),
        ),
        "fmi2DeSerializeFMUstate": (serialized, len(serialized), byref(c_void_p())),
    }[call]  # fmt: skip


def access_arguments(slave: Slave, call: str, running: bool) -> tuple:
    """Return valid arguments for getters and setters: one variable, if the model has such a one."""
    action, kind = call[4:7], call[7:]
    variables = [
        v for v in slave.fmu.of(kind)
        if action == "Get" or (v.settable(running=running) and v.start is not None)
    ][:1]  # fmt: skip
    if not variables:
        return (None, 0, None)
    value = 0 if action == "Get" else variables[0].start
    return (references(variables), 1, (variables[0].c_type * 1)(value))


def arguments(slave: Slave, call: str, state: str) -> tuple:
    """Return arguments with which a call works, where it is allowed."""
    if "FMUstate" in call:
        return state_arguments(slave, call)
    if call[4:7] in ("Get", "Set") and call[7:] in ("Real", "Integer", "Boolean", "String"):
        return access_arguments(slave, call, state not in STATES[:2])
    outputs = slave.fmu.of("Real", "output")[:1]
    # A source has no inputs; what it refuses, it refuses for that of an output, too.
    known = references(slave.fmu.of("Real", "input")[:1] or outputs)
    unknown = references(outputs)
    fixed = {
        "fmi2SetDebugLogging": (1, 1, texts(b"logAll")),
        "fmi2SetupExperiment": (0, 0.0, 0.0, 0, 0.0),
        "fmi2GetDirectionalDerivative": (unknown, 1, known, 1, reals(1.0), reals(0.0)),
        "fmi2SetRealInputDerivatives": (known, 1, integers(1), reals(0.5)),
        "fmi2GetRealOutputDerivatives": (unknown, 1, integers(1), reals(0.0)),
        "fmi2DoStep": (H, H, 1),
        "fmi2NewDiscreteStates": (create_string_buffer(64),),
        "fmi2CompletedIntegratorStep": (1, integers(0), integers(0)),
        "fmi2SetTime": (0.0,),
        "fmi2GetStatus": (DO_STEP_STATUS, integers(0)),
        "fmi2GetRealStatus": (LAST_SUCCESSFUL_TIME, reals(0.0)),
        "fmi2GetIntegerStatus": (DO_STEP_STATUS, integers(0)),
        "fmi2GetBooleanStatus": (TERMINATED, integers(0)),
        "fmi2GetStringStatus": (PENDING_STATUS, texts(None)),
    }  # fmt: skip
    # Of the rest, those that take arguments take an array of Reals and its length.
    return fixed.get(call, (reals(0.0), 1) if CALLS[call] else ())


@pytest.mark.parametrize("call", CALLS)
@pytest.mark.parametrize(("model", "state"), REACHABLE)
@isolated(timeout=20)
def test_call_is_allowed_as_the_table_says(fmus, model, state, call):
    slave = bring(Slave(unpack(fmus, model)), state)
    values = arguments(slave, call, state)
    before, logged = slave.snapshot(), len(slave.messages)
    status = getattr(slave, call)(*values)
    if is_allowed(model, call, state):
        assert status == OK, slave.told
        return
    assert status == ERROR
    assert slave.snapshot() == before
    assert len(slave.messages) == logged + 1, "the call is to be told once"
    assert slave.messages[-1].category == b"logStatusError"
    assert slave.messages[-1].status == ERROR
    assert call in slave.told
    if is_allowed(model, call, min(ALLOWED.get(call, [""]))):
        assert state in slave.told
        assert all(allowed in slave.told for allowed in ALLOWED[call])


@each_model
@pytest.mark.parametrize("call", CALLS)
@isolated(timeout=20)
def test_null_instead_of_an_instance_is_an_error(fmus, model, call):
    slave = Slave(unpack(fmus, model)).start()
    values = arguments(slave, call, "step complete")
    assert slave.library.functions[call](None, *values) == ERROR


@each_model
@isolated
def test_freeing_null_does_nothing(fmus, model):
    unpack(fmus, model).library.free_instance(None)


@each_model
@isolated
def test_version_and_platform_need_no_instance(fmus, model):
    library = unpack(fmus, model).library
    assert library.version() == b"2.0"
    assert library.types_platform() == b"default"


# --- from state to state ------------------------------------------------------------------------


@pytest.mark.parametrize(("model", "state"), REACHABLE)
@isolated
def test_instance_can_be_freed_in_any_state(fmus, model, state):
    bring(Slave(unpack(fmus, model)), state).free()


@pytest.mark.parametrize(("model", "state"), REACHABLE)
@isolated
def test_reset_equals_a_fresh_instance_bit_for_bit(fmus, model, state):
    fmu = unpack(fmus, model)
    slave = bring(Slave(fmu), state)
    assert slave.fmi2Reset() == OK
    assert slave.snapshot() == Slave(fmu).snapshot()
    used, fresh = bring(slave, "step complete"), bring(Slave(fmu), "step complete")
    assert used.snapshot() == fresh.snapshot()
    assert used.everything() == fresh.everything()


@each_model
@isolated
def test_reset_forgets_parameters_inputs_experiment_and_what_was_learned(fmus, model):
    fmu = unpack(fmus, model)
    slave = Slave(fmu)
    slave.put_all({v.name: v.other_value() for v in settable(fmu, running=False)})
    slave.start(5.0, 6.0)
    for k in range(10):
        assert slave.step(5.0 + 0.01 * k, 0.01) == OK
    assert slave.fmi2Reset() == OK
    assert slave.snapshot() == Slave(fmu).snapshot()
    slave.start()
    assert slave.everything() == Slave(fmu).start().everything()
    assert slave.step(0.0, 10.0) == OK, "the stop time is forgotten, too"


def settable(fmu, *, running: bool) -> list:
    """Return the variables that can be set to `other_value`; the pendulum keeps its form."""
    return [
        v for v in fmu.variables.values()
        if v.settable(running=running) and v.start is not None
        and v.name not in ("model", "ts", "frequency")
    ]  # fmt: skip


@each_model
@isolated
def test_experiment_may_be_set_up_again_before_the_initialization(fmus, model):
    slave = Slave(unpack(fmus, model))
    assert slave.fmi2SetupExperiment(1, 1e-6, 3.0, 1, 4.0) == OK
    slave.start(7.0)
    assert slave.step(7.0, H) == OK


@each_model
@pytest.mark.parametrize(
    ("start", "defined", "stop"),
    [
        (math.nan, 0, 0.0), (math.inf, 0, 0.0), (-math.inf, 0, 0.0),
        (0.0, 1, math.nan), (0.0, 1, math.inf), (1.0, 1, 0.5),
    ],
)  # fmt: skip
@isolated
def test_an_impossible_experiment_is_refused(fmus, model, start, defined, stop):
    slave = Slave(unpack(fmus, model))
    before = slave.snapshot()
    assert slave.fmi2SetupExperiment(0, 0.0, start, defined, stop) == ERROR
    assert "fmi2SetupExperiment" in slave.told
    assert slave.snapshot() == before


@each_model
@isolated
def test_what_is_not_defined_in_an_experiment_is_not_looked_at(fmus, model):
    slave = Slave(unpack(fmus, model))
    assert slave.fmi2SetupExperiment(0, math.nan, 1.0, 0, math.nan) == OK
    assert slave.fmi2EnterInitializationMode() == OK
    assert slave.fmi2ExitInitializationMode() == OK
    assert slave.step(1.0, H) == OK


# --- steps --------------------------------------------------------------------------------------


@each_model
@pytest.mark.parametrize("step", [0.0, -0.0])
@isolated
def test_a_step_of_zero_changes_nothing(fmus, model, step):
    slave = bring(Slave(unpack(fmus, model)), "step complete")
    before = slave.snapshot()
    assert slave.step(H, step) == OK
    assert slave.snapshot() == before
    assert slave.step(H, H) == OK


@each_model
@pytest.mark.parametrize(
    ("time", "step"),
    [
        (H, math.nan), (H, math.inf), (H, -math.inf), (H, -H), (H, -1e-300),
        (math.nan, H), (math.inf, H), (-math.inf, H),
    ],
)  # fmt: skip
@isolated(timeout=10)
def test_a_step_that_is_no_time_is_refused_and_changes_nothing(fmus, model, time, step):
    slave = bring(Slave(unpack(fmus, model)), "step complete")
    before = slave.snapshot()
    assert slave.step(time, step) == ERROR
    assert "fmi2DoStep" in slave.told
    assert slave.snapshot() == before
    assert slave.step(H, H) == OK


def tolerance(time: float, step: float) -> float:
    """Return how far [s] a communication point may be from where the last step ended."""
    return 1e-6 * step + 1e-9 * (1 + abs(time))


@each_model
@pytest.mark.parametrize("start", [0.0, 1e6, -3.0])
@pytest.mark.parametrize("side", [-1, 1])
@isolated
def test_time_goes_on_where_the_last_step_ended(fmus, model, start, side):
    slave = Slave(unpack(fmus, model)).start(start)
    assert slave.step(start, 0.25) == OK
    end = start + 0.25
    before = slave.snapshot()
    assert slave.step(end + 3 * side * tolerance(end, H), H) == ERROR
    assert slave.snapshot() == before
    assert repr(end) in slave.told or f"{end:g}" in slave.told
    assert slave.step(end + 0.3 * side * tolerance(end, H), H) == OK


@each_model
@pytest.mark.parametrize("gap", [-0.5, -0.01, 1.01, 2.0, 1000.0])
@isolated
def test_the_first_step_does_not_begin_before_the_start_or_much_later(fmus, model, gap):
    slave = Slave(unpack(fmus, model)).start(2.0)
    before = slave.snapshot()
    assert slave.step(2.0 + gap * H, H) == ERROR
    assert slave.snapshot() == before
    assert slave.step(2.0, H) == OK


@each_model
@pytest.mark.parametrize("gap", [0.5, 1.0])
@isolated
def test_the_first_step_may_begin_up_to_a_step_late_and_is_warned_of(fmus, model, gap):
    slave = Slave(unpack(fmus, model)).start(2.0)
    assert slave.step(2.0 + gap * H, H) in (OK, WARNING)
    assert slave.messages[-1].category == b"logStatusWarning"
    assert slave.messages[-1].status == WARNING
    assert slave.step(2.0 + (gap + 1) * H, H) == OK
    assert len(slave.messages) == 1


@each_model
@isolated
def test_a_first_step_at_the_start_is_not_warned_of(fmus, model):
    slave = Slave(unpack(fmus, model)).start(2.0)
    assert slave.step(2.0 + 1e-10, H) == OK
    assert slave.messages == []


@each_model
@isolated
def test_no_step_goes_past_the_stop_time(fmus, model):
    slave = Slave(unpack(fmus, model)).start(0.0, 0.01)
    assert slave.step(0.0, 0.004) == OK
    before = slave.snapshot()
    assert slave.step(0.004, 0.007) == ERROR
    assert "0.01" in slave.told
    assert slave.snapshot() == before
    assert slave.step(0.004, 0.006 + 1e-10) == OK, "rounding is borne"
    assert slave.step(0.01, 0.0) == OK
    assert slave.step(0.01, H) == ERROR


@each_model
@isolated
def test_an_experiment_without_stop_time_has_no_end(fmus, model):
    slave = Slave(unpack(fmus, model)).start()
    assert slave.step(0.0, 50.0) == OK


def status_of_time(slave: Slave) -> float:
    """Return what fmi2GetRealStatus says is the last successful time [s]."""
    time = reals(math.nan)
    assert slave.fmi2GetRealStatus(LAST_SUCCESSFUL_TIME, time) == OK
    return time[0]


@each_model
@isolated
def test_the_last_successful_time_is_the_end_of_the_last_step(fmus, model):
    slave = Slave(unpack(fmus, model)).start(3.0)
    assert status_of_time(slave) == 3.0
    for k in range(3):
        assert slave.step(3.0 + 0.25 * k, 0.25) == OK
        assert status_of_time(slave) == 3.25 + 0.25 * k
    assert slave.step(3.75, math.nan) == ERROR
    assert status_of_time(slave) == 3.75


@each_model
@isolated
def test_the_slave_never_ends_the_simulation_by_itself(fmus, model):
    slave = bring(Slave(unpack(fmus, model)), "step complete")
    answer = c_int(7)
    assert slave.fmi2GetBooleanStatus(TERMINATED, byref(answer)) == OK
    assert answer.value == 0


@each_model
@pytest.mark.parametrize("state", ["step complete", "terminated"])
@pytest.mark.parametrize(
    ("call", "kind"),
    [
        ("fmi2GetRealStatus", DO_STEP_STATUS), ("fmi2GetRealStatus", TERMINATED),
        ("fmi2GetRealStatus", 99), ("fmi2GetBooleanStatus", LAST_SUCCESSFUL_TIME),
        ("fmi2GetBooleanStatus", -1), ("fmi2GetIntegerStatus", TERMINATED),
        ("fmi2GetStatus", DO_STEP_STATUS), ("fmi2GetStringStatus", PENDING_STATUS),
    ],
)  # fmt: skip
@isolated
def test_other_kinds_of_status_are_refused(fmus, model, state, call, kind):
    slave = bring(Slave(unpack(fmus, model)), state)
    answer = {"Real": reals(7.0), "String": texts(b"7")}.get(call[7:-6], integers(7))
    assert getattr(slave, call)(kind, answer) == ERROR
    assert call in slave.told
    assert answer[0] in (7, b"7")


@each_model
@pytest.mark.parametrize("call", ["fmi2GetRealStatus", "fmi2GetBooleanStatus"])
@isolated
def test_a_status_without_a_place_for_it_is_refused(fmus, model, call):
    slave = Slave(unpack(fmus, model)).start()
    kind = LAST_SUCCESSFUL_TIME if "Real" in call else TERMINATED
    assert getattr(slave, call)(kind, None) == ERROR


# --- steps that fail ----------------------------------------------------------------------------

SAMPLERS = [model for model in MODELS if model != "Source"]


@pytest.mark.parametrize("model", SAMPLERS)
@isolated(timeout=10)
def test_a_step_with_too_many_samples_is_discarded_and_the_model_is_unchanged(fmus, model):
    slave = bring(Slave(unpack(fmus, model)).put_all(discards(model)), "step complete")
    state, before = slave.save(), slave.everything()
    assert slave.step(H, ENDLESS) == DISCARD
    assert slave.messages[-1].category == b"logStatusDiscard"
    assert slave.messages[-1].status == DISCARD
    assert slave.everything() == before
    assert status_of_time(slave) == H
    assert slave.step(H, H) == ERROR, "a failed step leaves a state to be restored"
    assert slave.fmi2SetFMUstate(state) == OK
    assert slave.step(H, H) == OK


@pytest.mark.parametrize("model", SAMPLERS)
@isolated(timeout=30)
def test_a_hundred_million_samples_are_the_limit(fmus, model):
    """At the finest sample time, 200 s hold 2e8 samples; 1 s holds 1e6."""
    slave = Slave(unpack(fmus, model)).put_all(discards(model)).start()
    assert slave.step(0.0, 1.0) == OK
    assert slave.step(1.0, 200.0) == DISCARD


@each_model
@pytest.mark.parametrize("step", [1e9, 1e300, 1.7e308])
@isolated(timeout=10)
def test_a_huge_step_does_not_hang(fmus, model, step):
    slave = Slave(unpack(fmus, model)).start()
    status = slave.step(0.0, step)
    assert status in (OK, DISCARD, ERROR)
    if status == OK:
        assert all(map(math.isfinite, slave.outputs()))
    assert slave.fmi2Reset() == OK
    assert slave.start().step(0.0, H) == OK


@pytest.mark.parametrize("form", [1, 2, 3])
@pytest.mark.parametrize("step", [1e9, 1e300])
@isolated(timeout=10)
def test_a_huge_step_of_a_moving_pendulum_does_not_hang(fmus, form, step):
    slave = Slave(unpack(fmus, "Pendulum")).put(model=form, theta0=0.3, omega0=2.0).start()
    assert slave.step(0.0, step) in (DISCARD, ERROR)


@pytest.mark.parametrize("step", [0.0015, 0.0004, 1 / 1024])
@isolated
def test_a_step_that_the_transfer_function_cannot_take_is_refused_and_changes_nothing(fmus, step):
    """It is no whole number of samples: a wrong argument, not a failure of the model."""
    slave = bring(Slave(unpack(fmus, "Pendulum")).put(model=1), "step complete")
    before = slave.snapshot()
    assert slave.step(H, step) == ERROR
    assert "whole number of ts" in slave.told
    assert slave.snapshot() == before
    assert slave.step(H, H) == OK


@each_model
@pytest.mark.parametrize("step", [5e-324, 1e-300, 6e-14])
@isolated(timeout=10)
def test_a_tiny_step_is_borne(fmus, model, step):
    slave = Slave(unpack(fmus, model)).start()
    for k in range(5):
        assert slave.step(k * step, step) == OK
    assert all(map(math.isfinite, slave.outputs()))


@each_model
@isolated
def test_an_error_is_told_and_a_reset_mends_it(fmus, model):
    slave = bring(Slave(unpack(fmus, model), debug=True), "error")
    failed = [m for m in slave.messages if m.status == ERROR]
    assert len(failed) == 1
    assert failed[0].category == b"logStatusError"
    assert "fmi2DoStep" in str(failed[0])
    assert slave.step(H, H) == ERROR
    assert slave.fmi2Reset() == OK
    assert bring(slave, "step complete").step(H, H) == OK


@each_model
@isolated
def test_a_state_from_before_the_error_mends_it_too(fmus, model):
    parameters, inputs, step = DIVERGES[model]
    slave = bring(Slave(unpack(fmus, model)).put_all(parameters), "step complete")
    state, before = slave.save(), slave.everything()
    assert slave.put_all(inputs).step(H, step) == ERROR
    assert slave.fmi2SetFMUstate(state) == OK
    assert slave.everything() == before
    assert slave.step(H, H) == OK


@each_model
@isolated
def test_strings_are_refused(fmus, model):
    """No FMU has a String: any reference is refused, none is fine."""
    slave = Slave(unpack(fmus, model)).start()
    text = c_char_p(b"text")
    for call in (slave.fmi2GetString, slave.fmi2SetString):
        assert call(None, 0, None) == OK
        assert call(references(slave.fmu.variables.values()), 1, byref(text)) == ERROR
        assert "String" in slave.told
    assert text.value == b"text"
