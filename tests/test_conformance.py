"""A correct FMU in C, `tests/c/conformance.c`, and the same FMU with one defect at a time."""

import faulthandler
import json
import multiprocessing
import os
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import fmpy
import pytest
from fmpy.fmi2 import FMU2Model, FMU2Slave

from pendulum_fmus.project import ROOT
from test_validate import Fmu, cargo_fmu, findings, write

pytestmark = pytest.mark.usefixtures("program")

SOURCES = ROOT / "tests" / "c"
DESCRIPTION = (SOURCES / "conformance.xml").read_text()

CS = "CoSimulation"
ME = "ModelExchange"
BOTH = "both"
KINDS = [CS, ME, BOTH]


class Defect(NamedTuple):
    """What an FMU gets wrong, and the rule by which `validate` must find it."""

    kind: str
    description: str
    rule: str | None
    """None if it cannot be found from outside or only by chance, or is no violation of a rule."""


DEFECTS = {
    "WRONG_PLATFORM": Defect(BOTH, 'fmi2GetTypesPlatform returns "other"', "version-functions"),
    "WRONG_VERSION": Defect(BOTH, 'fmi2GetVersion returns "1.0"', "version-functions"),
    "GUID_REFUSED": Defect(BOTH, "the GUID of the XML is refused", "loads"),
    "ANY_GUID_TAKEN": Defect(BOTH, "any GUID is accepted", "guid-checked"),
    "EXIT_IN_INSTANTIATE": Defect(BOTH, "fmi2Instantiate calls exit(0)", "survives"),
    "SECOND_INSTANCE_REFUSED": Defect(
        BOTH,
        "fmi2Instantiate returns NULL while or after another instance exists",
        "separate-instances",
    ),
    "ONE_INSTANCE_FOR_ALL": Defect(
        BOTH, "fmi2Instantiate returns the same instance every time", "survives"
    ),
    "EIGHT_INSTANCES_EVER": Defect(
        BOTH, "a process can make eight instances, even if it frees them", "any-thread"
    ),
    "LONG_NAME_OVERFLOWS": Defect(
        BOTH, "an instance name above 31 bytes overflows a buffer on the heap", "long-texts"
    ),
    "DEPENDS_ON_INSTANCE_NAME": Defect(
        BOTH, "the damping depends on the length of the instance name", "independent-of-host"
    ),
    "DEPENDS_ON_PREVIOUS_INSTANCE": Defect(
        BOTH,
        "the start value of x depends on how many instances were made before",
        "separate-instances",
    ),
    "DEPENDS_ON_RESOURCE_PATH": Defect(
        BOTH, "a NULL resource location crashes", "no-resource-location"
    ),
    "KEEPS_ARGUMENT_STRINGS": Defect(
        BOTH,
        "messages use the caller's instance name after fmi2Instantiate returned",
        "arguments-copied",
    ),
    "KEEPS_CALLBACK_POINTER": Defect(
        BOTH, "messages use the caller's callback structure after fmi2Instantiate returned", None
    ),
    "FREE_NULL_CRASHES": Defect(BOTH, "fmi2FreeInstance(NULL) crashes", "free-null"),
    "FREE_LOGS_AFTER": Defect(
        BOTH, "a thread calls the logger 50 ms after fmi2FreeInstance", "memory"
    ),
    "FREE_CRASHES": Defect(BOTH, "fmi2FreeInstance crashes", "survives"),
    "UNLOAD_CRASHES": Defect(BOTH, "unloading the library crashes", "survives"),
    "MISSING_FUNCTION": Defect(BOTH, "fmi2CancelStep is not exported", "loads"),
    "STEP_BEFORE_INIT_TAKEN": Defect(
        CS, "fmi2DoStep is accepted before initialization", "order-of-calls"
    ),
    "DOUBLE_INIT_TAKEN": Defect(
        BOTH, "fmi2EnterInitializationMode is accepted a second time", "order-of-calls"
    ),
    "STEP_AFTER_TERMINATE_TAKEN": Defect(
        CS, "fmi2DoStep is accepted after fmi2Terminate", "order-of-calls"
    ),
    "TERMINATE_ABORTS": Defect(BOTH, "fmi2Terminate calls abort", "survives"),
    "TERMINATE_LOSES_RESULTS": Defect(BOTH, "y is 0 after fmi2Terminate", "get-after-terminate"),
    "GET_AFTER_TERMINATE_REFUSED": Defect(
        BOTH, "values cannot be read after fmi2Terminate", "get-after-terminate"
    ),
    "STEP_AFTER_ERROR_WRONG": Defect(BOTH, "y is 0 after any refused call", None),
    "EXITS_ON_ERROR": Defect(BOTH, "any refused call calls exit(1)", "survives-misuse"),
    "NEGATIVE_STEP_TAKEN": Defect(CS, "fmi2DoStep accepts a negative step", "step-arguments"),
    "WRONG_TIME_TAKEN": Defect(
        CS,
        "fmi2DoStep accepts a communication point that is not the time of the FMU",
        "step-arguments",
    ),
    "PAST_STOP_TIME_TAKEN": Defect(
        CS, "fmi2DoStep accepts a step past the stop time", "past-stop-time"
    ),
    "STEP_STATUS_UNKNOWN": Defect(CS, "fmi2DoStep returns 77", "runs"),
    "STEP_DISCARDS": Defect(CS, "fmi2DoStep returns fmi2Discard", "runs"),
    "STEP_PENDING": Defect(
        CS, "fmi2DoStep returns fmi2Pending without canRunAsynchronuously", "runs"
    ),
    "STEP_WARNS": Defect(CS, "fmi2DoStep returns fmi2Warning without a message", None),
    "STEP_ERROR_WITHOUT_MESSAGE": Defect(BOTH, "refused calls log nothing", None),
    "DISCARD_THEN_LOST": Defect(
        CS, "fmi2DoStep returns fmi2Discard after 1 s and loses the state", "runs"
    ),
    "LAST_TIME_WRONG": Defect(CS, "fmi2LastSuccessfulTime is always 0", None),
    "GET_STATUS_CRASHES": Defect(CS, "fmi2GetRealStatus crashes", "survives-misuse"),
    "CANCEL_STEP_CRASHES": Defect(CS, "fmi2CancelStep crashes", "survives-misuse"),
    "HANG_IN_INIT": Defect(BOTH, "fmi2EnterInitializationMode does not return", "survives"),
    "HANG_IN_STEP": Defect(BOTH, "a step after 0.5 s does not return", "survives"),
    "HANG_IN_TERMINATE": Defect(BOTH, "fmi2Terminate does not return", "survives"),
    "NVR_ZERO_CRASHES": Defect(BOTH, "a get or set of no variables crashes", "zero-references"),
    "PARTIAL_SET": Defect(
        BOTH, "a refused set has written the variables before the wrong one", None
    ),
    "SET_ERROR_RETURNS_OK": Defect(BOTH, "a refused set returns fmi2OK", "unknown-references"),
    "RESET_KEEPS_STATE": Defect(BOTH, "fmi2Reset keeps x and v", "reset"),
    "RESET_KEEPS_PARAMETERS": Defect(BOTH, "fmi2Reset keeps parameters", "reset"),
    "RESET_KEEPS_INPUT": Defect(BOTH, "fmi2Reset keeps u", "reset"),
    "RESET_KEEPS_STRING": Defect(BOTH, "fmi2Reset keeps a String input", "reset"),
    "RESET_KEEPS_TIME": Defect(
        BOTH, "fmi2Reset keeps the time, and fmi2SetupExperiment does not set it", "reset"
    ),
    "RESET_KEEPS_PHASE": Defect(
        BOTH, 'fmi2Reset does not return to the state "instantiated"', "reset"
    ),
    "RESET_REFUSED": Defect(BOTH, "fmi2Reset returns fmi2Error", "reset"),
    "RESET_CRASHES": Defect(BOTH, "fmi2Reset crashes", "survives"),
    "SHARED_STATIC": Defect(BOTH, "all instances share the input u", "separate-instances"),
    "SHARED_STRING_BUFFER": Defect(
        BOTH, "all instances share the buffer of a String output", "string-lifetime"
    ),
    "TWO_THREADS_RACE": Defect(BOTH, "instances in different threads share a scratch buffer", None),
    "SECOND_THREAD_WRONG": Defect(
        BOTH, "y is 0 in threads other than the one that made the last instance", "any-thread"
    ),
    "GET_STATE_REFUSED": Defect(BOTH, "fmi2GetFMUstate returns fmi2Error", "state"),
    "SET_STATE_IGNORED": Defect(BOTH, "fmi2SetFMUstate does nothing", "state"),
    "STATE_LOSES_DISCRETE": Defect(BOTH, "the FMU state lacks the discrete states", "state"),
    "STATE_LOSES_CONTINUOUS": Defect(BOTH, "the FMU state lacks v", "state"),
    "STATE_LOSES_TIME": Defect(BOTH, "the FMU state lacks the time", "state"),
    "STATE_LOSES_PARAMETER": Defect(BOTH, "the FMU state lacks a parameter", "state"),
    "STATE_LOSES_INPUT": Defect(BOTH, "the FMU state lacks the input u", "state"),
    "STATE_LOSES_STRING": Defect(BOTH, "the FMU state lacks a String", "state"),
    "STATE_LOSES_PHASE": Defect(BOTH, "the FMU state lacks the state of the state machine", None),
    "STATE_ALIASES_INSTANCE": Defect(
        BOTH, "an FMU state is a pointer to the live instance", "state"
    ),
    "STATE_SHARED": Defect(BOTH, "all FMU states are the same memory", "state"),
    "STATE_USED_UP": Defect(BOTH, "an FMU state can be restored once", "state"),
    "STATE_OVERWRITE_LEAKS": Defect(
        BOTH, "fmi2GetFMUstate allocates although it got a state to overwrite", "memory"
    ),
    "FREE_STATE_KEEPS_POINTER": Defect(
        BOTH, "fmi2FreeFMUstate does not set the pointer to NULL", "state"
    ),
    "FREE_STATE_NULL_CRASHES": Defect(
        BOTH, "fmi2FreeFMUstate with a NULL state crashes", "free-null"
    ),
    "FREE_STATE_LEAKS": Defect(BOTH, "fmi2FreeFMUstate frees nothing", "memory"),
    "DAMAGED_STATE_TAKEN": Defect(BOTH, "damaged bytes of a state are accepted", "damaged-state"),
    "DAMAGED_STATE_CRASHES": Defect(BOTH, "damaged bytes of a state crash", "survives-misuse"),
    "TRUNCATED_STATE_TAKEN": Defect(
        BOTH, "truncated bytes of a state are accepted", "damaged-state"
    ),
    "STATE_SIZE_TOO_SMALL": Defect(
        BOTH, "fmi2SerializeFMUstate writes more bytes than announced", "serialized-state"
    ),
    "STATE_SIZE_HUGE": Defect(BOTH, "fmi2SerializedFMUstateSize says 2^64 - 1", "serialized-state"),
    "SERIALIZE_WRITES_NOTHING": Defect(
        BOTH, "fmi2SerializeFMUstate writes nothing", "serialized-state"
    ),
    "STATE_BYTES_DIFFER": Defect(BOTH, "the bytes of one state differ in each call", None),
    "STATE_HOLDS_POINTER": Defect(BOTH, "the bytes of a state hold a pointer", "serialized-state"),
    "WRONG_START": Defect(BOTH, "x starts at 1.5 instead of 1", "start-values"),
    "UNKNOWN_REFERENCE_READ": Defect(
        BOTH, "unknown value references read as 0", "unknown-references"
    ),
    "UNKNOWN_REFERENCE_SET": Defect(
        BOTH, "unknown value references can be set", "unknown-references"
    ),
    "WRONG_TYPE_REFERENCE_TAKEN": Defect(
        BOTH, "fmi2GetReal reads an Integer", "unknown-references"
    ),
    "OUTPUT_REFUSED": Defect(BOTH, "y cannot be read", "readable"),
    "OUTPUT_SETTABLE": Defect(BOTH, "outputs can be set", "settable"),
    "CONSTANT_SETTABLE": Defect(BOTH, "a constant can be set", "settable"),
    "CONSTANT_CHANGES": Defect(BOTH, "a constant changes with time", "constants"),
    "FIXED_PARAMETER_SETTABLE_LATER": Defect(
        BOTH, "fixed parameters can be set after initialization", "settable"
    ),
    "TUNABLE_REFUSED": Defect(
        BOTH, "tunable parameters cannot be set after initialization", "tunable"
    ),
    "TUNABLE_IGNORED": Defect(BOTH, "the stiffness has no effect on the derivatives", None),
    "PARAMETER_IGNORED": Defect(BOTH, "the damping has no effect", None),
    "CALCULATED_PARAMETER_STALE": Defect(BOTH, "omega ignores the stiffness", None),
    "SET_IN_INIT_IGNORED": Defect(
        BOTH, "values set in initialization mode are ignored", "inputs-kept"
    ),
    "OUTPUT_NOT_UPDATED_IN_INIT": Defect(
        BOTH, "Real outputs in initialization mode ignore what was set there", "initial-outputs"
    ),
    "OUTPUT_STALE": Defect(CS, "Real outputs are those of the communication point before", "state"),
    "STRING_INPUT_IGNORED": Defect(BOTH, "the String output ignores its input", None),
    "STRING_FREED_TOO_EARLY": Defect(
        BOTH, "fmi2GetString returns memory that is free", "valid-values"
    ),
    "STRING_NULL": Defect(BOTH, "fmi2GetString returns a NULL string", "readable"),
    "STRING_NOT_UTF8": Defect(BOTH, "fmi2GetString returns a string in Latin-1", "valid-values"),
    "LONG_STRING_OVERFLOWS": Defect(BOTH, "a long string overflows a buffer", "long-texts"),
    "INTEGER_TRUNCATED": Defect(BOTH, "an Integer input is cut to 16 bits", None),
    "REAL_TRUNCATED": Defect(BOTH, "Reals are cut to single precision", "inputs-kept"),
    "BOOLEAN_IS_2": Defect(BOTH, "true is 2", "valid-values"),
    "ENUMERATION_OUT_OF_RANGE": Defect(
        BOTH, "an Enumeration output has a value that is no item", "valid-values"
    ),
    "OUTPUT_OUTSIDE_MIN_MAX": Defect(BOTH, "an output leaves its min and max", "bounds"),
    "ALIAS_DIFFERS": Defect(
        BOTH, "an alias differs if both variables are read in one call", "get-is-pure"
    ),
    "GET_HAS_SIDE_EFFECTS": Defect(BOTH, "every get changes x", "get-is-pure"),
    "GET_ORDER_MATTERS": Defect(
        BOTH, "values are wrong if the references of a call do not ascend", "get-is-pure"
    ),
    "GET_WRITES_PAST_END": Defect(BOTH, "gets write one value too many", "survives"),
    "SET_WRITES_ARGUMENT": Defect(BOTH, "sets write to the caller's values", "writes-inside"),
    "UNDECLARED_DEPENDENCY": Defect(
        BOTH, "energy depends on u, which the XML denies", "true-dependencies"
    ),
    "NAN_OUTPUT": Defect(BOTH, "y is NaN after the first step", "finite-outputs"),
    "NAN_OUTPUT_LATE": Defect(BOTH, "y is NaN after 1.5 s", "finite-outputs"),
    "INFINITE_OUTPUT": Defect(BOTH, "y is infinite after 0.5 s", "finite-outputs"),
    "NAN_TAKEN": Defect(BOTH, "NaN and infinity can be set", None),
    "HANG_ON_NAN": Defect(BOTH, "NaN as a value, time or step does not return", "survives-nan"),
    "ABORT_ON_NAN": Defect(BOTH, "NaN as a value, time or step calls abort", "survives-nan"),
    "CRASH_ON_INF": Defect(BOTH, "infinity as a value, time or step crashes", "survives-nan"),
    "DEPENDS_ON_STOP_TIME": Defect(
        BOTH, "the damping depends on the stop time", "independent-of-stop-time"
    ),
    "DEPENDS_ON_STEP_SIZE": Defect(
        CS, "the integrator takes one Euler step per communication step", "half-steps"
    ),
    "DEPENDS_ON_LOGGING": Defect(BOTH, "y depends on whether logging is on", "independent-of-host"),
    "DEPENDS_ON_WALL_CLOCK": Defect(BOTH, "y depends on the clock", "reproducible"),
    "DEPENDS_ON_ADDRESS": Defect(BOTH, "y depends on the address of the instance", "reproducible"),
    "DEPENDS_ON_RANDOM": Defect(BOTH, "y has noise from rand()", "reset"),
    "DEPENDS_ON_ENVIRONMENT": Defect(BOTH, "y depends on the current directory", None),
    "UNINITIALISED_FIELD": Defect(
        BOTH, "y depends on memory that was never written", "initialised-memory"
    ),
    "START_TIME_IGNORED": Defect(BOTH, "the time always starts at 0", None),
    "SAMPLE_NEEDS_EXACT_TIME": Defect(
        BOTH, "samples are missed unless the time is equal to the last bit", None
    ),
    "ONE_SAMPLE_PER_STEP": Defect(CS, "a step takes one sample at most", None),
    "ONE_STEP_SIZE_ONLY": Defect(
        CS, "fmi2DoStep refuses steps other than 0.01 s", "variable-step-size"
    ),
    "SAMPLES_OVERFLOW": Defect(BOTH, "the samples overflow a buffer of 16 on the heap", "heap"),
    "CRASH_IN_STEP": Defect(BOTH, "the first step crashes", "survives"),
    "CRASH_LATER": Defect(BOTH, "a step after 0.5 s crashes", "survives"),
    "ABORT_LATER": Defect(BOTH, "a step after 0.5 s calls abort", "survives"),
    "EXIT_LATER": Defect(BOTH, "a step after 0.5 s calls exit(0)", "survives"),
    "FATAL_LATER": Defect(CS, "a step after 0.5 s returns fmi2Fatal", "runs"),
    "STACK_OVERFLOW_LATER": Defect(BOTH, "a step after 0.5 s recurses without end", "survives"),
    "WRONG_DIRECTIONAL_DERIVATIVE": Defect(BOTH, "d der(v) / d x has the wrong sign", None),
    "WRONG_DIRECTIONAL_DERIVATIVE_LATE": Defect(
        BOTH, "d der(v) / d x has the wrong sign after 0.5 s", None
    ),
    "DIRECTIONAL_DERIVATIVE_REFUSED": Defect(
        BOTH, "fmi2GetDirectionalDerivative returns fmi2Error", "directional-derivatives"
    ),
    "OUTPUT_DERIVATIVE_REFUSED": Defect(
        CS, "fmi2GetRealOutputDerivatives returns fmi2Error", "output-derivatives"
    ),
    "OUTPUT_DERIVATIVE_WRONG": Defect(
        CS, "derivatives of outputs have the wrong sign", "output-derivatives"
    ),
    "INPUT_DERIVATIVE_REFUSED": Defect(
        CS, "fmi2SetRealInputDerivatives returns fmi2Error", "input-derivatives"
    ),
    "INPUT_DERIVATIVE_IGNORED": Defect(
        CS, "fmi2SetRealInputDerivatives has no effect", "input-derivatives"
    ),
    "LEAK_PER_INSTANCE": Defect(BOTH, "10 kB leak with each instance", "memory"),
    "LEAK_PER_CALLBACK": Defect(
        BOTH, "10 kB from allocateMemory are not given back with each instance", "memory"
    ),
    "LEAK_PER_STEP": Defect(BOTH, "1 kB leaks with each step", "memory"),
    "LEAK_PER_GET": Defect(BOTH, "100 bytes leak with each get", "memory"),
    "FILLS_MEMORY": Defect(BOTH, "a step after 0.5 s allocates without end", "survives"),
    "WRITES_AFTER_FREE": Defect(
        BOTH, "fmi2FreeInstance writes to the memory that it has freed", None
    ),
    "DOUBLE_FREE": Defect(BOTH, "a step frees memory twice", "survives"),
    "OVERFLOWS_HEAP": Defect(BOTH, "a step writes 24 bytes past a block on the heap", "survives"),
    "STEPS_SLOW_DOWN": Defect(BOTH, "each step takes longer than the one before", "steady-time"),
    "PRINTS_TO_STDOUT": Defect(BOTH, "steps print to stdout", "prints"),
    "PRINTS_TO_STDERR": Defect(BOTH, "steps print to stderr", "prints"),
    "CLOSES_STDOUT": Defect(BOTH, "fmi2Instantiate closes stdout", "environment"),
    "CHANGES_DIRECTORY": Defect(
        BOTH, "fmi2Instantiate changes the working directory", "working-directory"
    ),
    "CHANGES_LOCALE": Defect(BOTH, "fmi2Instantiate changes the locale", "locale"),
    "CHANGES_ROUNDING_MODE": Defect(
        BOTH, "fmi2Instantiate changes the rounding mode", "arithmetic"
    ),
    "SETS_FLUSH_TO_ZERO": Defect(
        BOTH, "fmi2Instantiate makes subnormal numbers zero", "arithmetic"
    ),
    "ENABLES_FP_EXCEPTIONS": Defect(
        BOTH, "fmi2Instantiate turns floating-point exceptions into signals", "survives"
    ),
    "CHANGES_UMASK": Defect(BOTH, "fmi2Instantiate changes the umask", "environment"),
    "CHANGES_RANDOM_SEED": Defect(BOTH, "fmi2Instantiate seeds rand()", None),
    "INSTALLS_SIGNAL_HANDLER": Defect(BOTH, "fmi2Instantiate installs signal handlers", "signals"),
    "LEAVES_THREAD": Defect(BOTH, "fmi2Instantiate starts a thread that never ends", "handles"),
    "LEAVES_FILE_OPEN": Defect(
        BOTH, "fmi2Instantiate opens a file and does not close it", "handles"
    ),
    "WRITES_FILE_IN_CWD": Defect(
        BOTH, "fmi2Instantiate writes a file to the working directory", "files"
    ),
    "WRITES_RESOURCES": Defect(BOTH, "fmi2Instantiate writes a file to the resources", "files"),
    "SETS_ENVIRONMENT": Defect(BOTH, "fmi2Instantiate sets an environment variable", "environment"),
    "LEAVES_CHILD": Defect(
        BOTH, "fmi2Instantiate starts a process that it leaves running", "handles"
    ),
    "SETS_ALARM": Defect(
        BOTH, "fmi2Instantiate sets an alarm that ends the process after 1 s", None
    ),
    "NULL_LOGGER_CALLED": Defect(BOTH, "a NULL logger is called", "no-logger"),
    "LOGS_WITHOUT_CONSENT": Defect(
        BOTH, "messages are logged although logging is off", "logging-off"
    ),
    "LOG_CATEGORY_IGNORED": Defect(
        BOTH, "messages of categories that were not chosen are logged", None
    ),
    "LOGGER_FORMAT_FROM_DATA": Defect(
        BOTH, "a String value becomes the format of the logger", "log-format"
    ),
    "LOGS_NULL_CATEGORY": Defect(BOTH, "the category of messages is NULL", "log-category"),
    "LOGS_UNDECLARED_CATEGORY": Defect(
        BOTH, "the category of messages is not in the XML", "log-category-declared"
    ),
    "LOGS_WRONG_ENVIRONMENT": Defect(
        BOTH, "messages have another environment than the host gave", "log-environment"
    ),
    "LOGS_WRONG_NAME": Defect(
        BOTH, "messages have another instance name than the host gave", "arguments-copied"
    ),
    "LOGS_WRONG_STATUS": Defect(BOTH, "messages about errors have the status fmi2OK", None),
    "UNKNOWN_CATEGORY_CRASHES": Defect(BOTH, "an unknown log category crashes", "survives-misuse"),
    "LOGGING_REFUSED": Defect(BOTH, "fmi2SetDebugLogging returns fmi2Error", "runs"),
    "NEVER_LEAVES_EVENT_ITERATION": Defect(
        ME, "fmi2NewDiscreteStates always asks for another call", "runs"
    ),
    "EVENT_INFO_NOT_WRITTEN": Defect(
        ME, "fmi2NewDiscreteStates does not write the event information", "event-iteration"
    ),
    "NEXT_EVENT_IN_PAST": Defect(ME, "the next time event is in the past", "runs"),
    "NEXT_EVENT_MISSING": Defect(ME, "the next time event is not announced", None),
    "STATE_CHANGE_NOT_SAID": Defect(
        ME, "fmi2NewDiscreteStates changes v and does not say so", "runs"
    ),
    "EVENT_INDICATOR_CHANGES_ON_READ": Defect(
        ME, "the event indicator changes its sign with each read", "event-iteration"
    ),
    "EVENT_INDICATOR_CONSTANT": Defect(ME, "the event indicator is always 1", None),
    "EVENT_INDICATOR_NAN": Defect(ME, "the event indicator is NaN", "event-iteration"),
    "DERIVATIVES_USE_STALE_STATE": Defect(
        ME, "derivatives use the states of the last completed step", "directional-derivatives"
    ),
    "DERIVATIVES_USE_STALE_INPUT": Defect(
        ME, "derivatives use the input of the last completed step", "event-iteration"
    ),
    "DERIVATIVES_HAVE_SIDE_EFFECTS": Defect(
        ME, "fmi2GetDerivatives changes a parameter", "event-iteration"
    ),
    "WRONG_DERIVATIVE_LATE": Defect(ME, "fmi2GetDerivatives and der(v) differ after 0.5 s", None),
    "DERIVATIVES_SWAPPED": Defect(
        ME, "fmi2GetDerivatives has another order than the XML", "directional-derivatives"
    ),
    "STATES_SWAPPED": Defect(
        ME, "the continuous states have another order than the XML", "directional-derivatives"
    ),
    "WRONG_STATE_COUNT_TAKEN": Defect(ME, "the number of continuous states is not checked", None),
    "COMPLETED_STEP_MISSING": Defect(
        ME, "fmi2CompletedIntegratorStep does not write its results", "event-iteration"
    ),
    "TIME_BACK_REFUSED": Defect(
        ME, "fmi2SetTime refuses to go back within a step", "event-iteration"
    ),
    "NOMINAL_ZERO": Defect(ME, "a nominal value of a state is 0", "runs"),
    "NOMINAL_NAN": Defect(ME, "a nominal value of a state is NaN", "runs"),
    "DISCRETE_CHANGES_IN_CONTINUOUS_TIME": Defect(
        ME, "a discrete output changes in continuous-time mode", None
    ),
    "ENTER_EVENT_MODE_REFUSED": Defect(ME, "fmi2EnterEventMode returns fmi2Error", "runs"),
    "TERMINATES_SIMULATION": Defect(ME, "the FMU ends the simulation after 0.5 s", None),
}

FOUND = [name for name in DEFECTS if DEFECTS[name].rule]

FEW = list({DEFECTS[name].rule: name for name in reversed(FOUND)}.values())
"""One defect for each rule."""

ALL = "ALL_DEFECTS" in os.environ
"""Whether to test all defects, as `make conformance` does, instead of a few."""

FATAL = {
    "EXIT_IN_INSTANTIATE",
    "FREE_CRASHES",
    "GUID_REFUSED",
    "MISSING_FUNCTION",
    "UNLOAD_CRASHES",
}
"""Defects that show as soon as FMPy makes an instance and frees it."""

FREED = 42
"""Exit code of a process that has freed its instance."""


def describe(kind: str) -> bytes:
    """Return the model description of an FMU for one kind of simulation or for both."""
    other = {CS: ME, ME: CS}.get(kind)
    text = re.sub(rf"  <{other}.*?/>\n", "", DESCRIPTION, flags=re.S) if other else DESCRIPTION
    return text.encode()


@pytest.fixture(scope="session")
def library(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], bytes]:
    """Return a function that compiles the FMU with a defect, once per session."""
    compiler = shutil.which("cc") or pytest.skip("no C compiler")
    folder = tmp_path_factory.mktemp("conformance")

    def compiled(defect: str) -> bytes:
        file = folder / f"{defect}.so"
        if not file.exists():
            define = [f"-DDEFECT={defect}"]
            if defect == "MISSING_FUNCTION":
                define.append("-DWITHOUT_CANCEL_STEP")
            subprocess.run(
                [compiler, "-shared", "-fPIC", "-O1", "-Wall", "-Wextra", "-Werror", "-pthread",
                 "-fvisibility=hidden", *define, "-o", file, SOURCES / "conformance.c", "-lm"],
                check=True,
            )  # fmt: skip
        return file.read_bytes()

    return compiled


@pytest.fixture
def conformance(
    library: Callable[[str], bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., Path]:
    """Return a function that packs the FMU with a defect, which may write to the working folder."""
    monkeypatch.chdir(tmp_path)

    def make(defect: str = "NO_DEFECT", kind: str = BOTH) -> Path:
        content: Fmu = {
            "modelDescription.xml": describe(kind),
            "binaries/linux64/Conformance.so": library(defect),
        }
        return write(tmp_path / "Conformance.fmu", content)

    return make


def kind_of(defect: str) -> str:
    """Return the kind of FMU that shows a defect."""
    kind = DEFECTS[defect].kind
    return CS if kind == BOTH else kind


def test_the_table_has_every_defect_of_the_source() -> None:
    source = re.sub(r"/\*.*?\*/", "", (SOURCES / "conformance.h").read_text(), flags=re.S)
    listed = re.search(r"enum Defect \{(.*?)\}", source, flags=re.S)
    assert listed
    assert re.findall(r"\w+", listed[1]) == ["NO_DEFECT", *DEFECTS]


@pytest.mark.parametrize("kind", KINDS)
def test_the_correct_fmu_has_no_findings(conformance: Callable[..., Path], kind: str) -> None:
    assert findings(conformance(kind=kind), ()) == []


def load(file: Path, kind: str, folder: Path) -> None:
    """Make an instance of an FMU and free it, and end the process with the code FREED."""
    faulthandler.disable()
    fmu_class = FMU2Slave if kind == CS else FMU2Model
    fmu = fmu_class(
        guid="{conformance}",
        unzipDirectory=fmpy.extract(str(file), str(folder)),
        modelIdentifier="Conformance",
    )
    fmu.instantiate()
    fmu.freeInstance()
    os._exit(FREED)


@pytest.mark.parametrize("defect", DEFECTS if ALL else FEW)
def test_every_defect_can_be_loaded(
    conformance: Callable[..., Path], defect: str, tmp_path: Path
) -> None:
    kind = kind_of(defect)
    arguments = (conformance(defect, kind), kind, tmp_path / "unpacked")
    child = multiprocessing.get_context("fork").Process(target=load, args=arguments)
    child.start()
    child.join(20)
    assert (child.exitcode == FREED) == (defect not in FATAL)


@pytest.mark.parametrize("defect", FOUND if ALL else FEW)
def test_a_defect_is_found(conformance: Callable[..., Path], defect: str) -> None:
    fmu = conformance(defect, kind_of(defect))
    report = json.loads(cargo_fmu("validate", "--format", "json", "--time-limit", "5", fmu).stdout)
    found = {rule["id"]: rule["findings"] for rule in report["files"][0]["rules"]}
    assert DEFECTS[defect].rule in found, found


@pytest.mark.parametrize("defect", ["CRASH_IN_STEP", "HANG_IN_INIT", "EXIT_IN_INSTANTIATE"])
def test_no_run_does_not_run_the_binary(conformance: Callable[..., Path], defect: str) -> None:
    assert findings(conformance(defect), ("--no-run",)) == []


def test_nothing_is_left_behind(
    conformance: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fmu = conformance("CRASH_IN_STEP")
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    findings(fmu)
    assert list(folder.iterdir()) == []


def test_a_crash_after_a_simulation_does_not_lose_its_results(
    conformance: Callable[..., Path], tmp_path: Path
) -> None:
    fmu = conformance("UNLOAD_CRASHES", CS)
    system, results = tmp_path / "system.toml", tmp_path / "results.csv"
    system.write_text(f'stop = 1.0\nstep = 0.1\n[[component]]\nname = "a"\nfmu = "{fmu}"\n')
    run = cargo_fmu("simulate", system, "--csv", results)
    assert run.returncode == 0
    assert "after the simulation" in run.stderr
    assert len(results.read_text().splitlines()) == 12
