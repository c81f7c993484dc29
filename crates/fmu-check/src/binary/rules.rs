//! The rules for the behaviour of binaries.

use crate::rule::rules;

rules! {
    /// Rules for what a binary does when it is run.
    pub BEHAVIOUR {
        NOT_RUN: Warning, "binary-not-run", Practice("what is not run is not tested"),
            "There is a binary for the machine that runs the validator.";
        NOT_TESTED: Warning, "not-tested", Practice("what is not tested may be wrong"),
            "The FMU is fast and small enough for all tests.";
        LOADS: Error, "loads", Standard("section 2.3", "section 2.5"),
            "The binary for this machine loads and exports the functions of its kind.";
        VERSION: Error, "version-functions", Standard("section 2.1.4", "section 2.2.5"),
            "fmi2GetVersion returns \"2.0\" and fmi2GetTypesPlatform \"default\"; fmi3GetVersion returns \"3.0\".";
        RUNS: Error, "runs", Standard("sections 3.2 and 4.2", "sections 3.2 and 4.2"),
            "Calls that the standard allows succeed when the default experiment is run.";
        SURVIVES: Error, "survives", Standard("section 2.1.3", "section 2.2.4"),
            "Functions return a status; they do not crash, hang, or end the process.";
        GUID: Warning, "guid-checked", Standard("section 2.1.5", "section 2.3.1"),
            "fmi2Instantiate returns NULL for the GUID of another FMU.";
        FREE_NULL: Error, "free-null", Fmi2("sections 2.1.5 and 2.1.8"),
            "fmi2FreeInstance and fmi2FreeFMUstate ignore NULL.";
        NO_RESOURCES: Warning, "no-resource-location",
            Practice("PyFMI and test benches pass NULL or an empty location to FMUs without resources"),
            "fmi2Instantiate returns for a resource location of NULL.";
        NO_LOGGER: Warning, "no-logger", Practice("small hosts pass no logger"),
            "The FMU does not call a logger that is NULL.";
        ARGUMENTS_COPIED: Error, "arguments-copied", Standard("section 2.1.5", "section 2.3.1"),
            "The FMU copies the strings of fmi2Instantiate, which are valid during the call only.";
        START: Error, "start-values", Standard("section 2.2.7", "section 2.4.7.5"),
            "The start values of the binary are those of the XML.";
        READABLE: Error, "readable", Standard("section 2.1.7", "section 2.2.7.2"),
            "Every variable of the XML can be read.";
        FINITE: Error, "finite-outputs",
            Practice("every solver, plot and controller behind the FMU fails on NaN"),
            "Outputs and derivatives of states are finite numbers.";
        VALID_VALUES: Error, "valid-values", Standard("sections 2.1.2, 2.1.7 and 2.2.7", "sections 2.2.3 and 2.2.7.2"),
            "Booleans are 0 or 1, enumerations have the value of an item, and Strings are UTF-8.";
        BOUNDS: Warning, "bounds", Standard("section 2.2.7", "section 2.2.7.3"),
            "Outputs stay between the min and max of the XML.";
        CONSTANT: Error, "constants", Standard("section 2.2.7", "section 2.4.7.4"),
            "Constants, and parameters that are not set, keep their values after initialization.";
        ALIASES: Error, "aliases", Fmi2("section 2.2.7"),
            "Variables with the same value reference have the same value.";
        PURE_GET: Error, "get-is-pure", Practice("hosts read variables as often and in the order that they like"),
            "Reading a variable changes nothing, and its value does not depend on what is read with it.";
        WRITES_INSIDE: Error, "writes-inside", Standard("section 2.1.7", "section 2.2.7.2"),
            "Functions write no more values than they are asked for.";
        NO_VARIABLES: Error, "zero-references", Practice("hosts pass NULL with a length of 0"),
            "Functions that get or set 0 variables succeed.";
        SINGLE_PRECISION: Warning, "single-precision", Standard("section 2.1.7", "section 2.2.7.2"),
            "A Real is kept with the digits of a Float64.";
        INPUTS_KEPT: Error, "inputs-kept", Standard("section 2.1.7", "section 2.2.7.2"),
            "An input or parameter that was set reads back as it was set.";
        STRINGS: Error, "string-lifetime", Standard("section 2.1.7", "section 2.2.7.2"),
            "Strings stay valid until the next call, and those of two instances are separate.";
        UNKNOWN_REFERENCE: Warning, "unknown-references",
            Practice("a host with another version of the XML reads and writes foreign memory"),
            "Value references that the XML does not list are refused.";
        SETTABLE: Warning, "settable", Practice("a mistake of the host goes unnoticed"),
            "What the XML does not allow to set is refused.";
        TUNABLE: Error, "tunable", Standard("section 2.2.7", "section 2.4.7.4"),
            "Tunable parameters can be set between two steps.";
        REPRODUCIBLE: Warning, "reproducible",
            Practice("a result that differs from run to run cannot be verified"),
            "Two runs give the same results.";
        INITIALISED: Error, "initialised-memory",
            Practice("reading uninitialised memory is undefined behaviour in C"),
            "Results do not depend on the contents of uninitialised memory.";
        INDEPENDENT: Warning, "independent-of-host",
            Practice("results must not depend on what has no meaning for the model"),
            "Results do not depend on the name of the instance, logging, or the working directory.";
        STOP_TIME: Warning, "independent-of-stop-time", Standard("section 2.1.6", "section 2.3.2"),
            "Results up to a time do not depend on the stop time of fmi2SetupExperiment.";
        MICRO_STEPS: Warning, "micro-steps",
            Practice("OMSimulator ends a run with steps of 1e-13 s, and FMPy's steps differ in the last bit"),
            "A step in two parts, one of them tiny, gives nearly the same results.";
        ROUNDED_TIMES: Error, "rounded-times",
            Practice("libcosim, FMPy and OMSimulator pass times that differ in the last digits"),
            "Results do not depend on the last digits of the times of communication points.";
        PAST_STOP: Warning, "past-stop-time", Fmi2("section 2.1.6"),
            "A step beyond the stop time of fmi2SetupExperiment returns fmi2Error.";
        HALF_STEPS: Warning, "half-steps",
            Practice("hosts with other communication step sizes get other results"),
            "Two steps of half the size give nearly the same results as one.";
        STEP_SIZE: Error, "variable-step-size", Standard("section 4.3.1", "section 4.4"),
            "If canHandleVariableCommunicationStepSize is true, other step sizes are accepted.";
        RESET: Error, "reset", Standard("section 2.1.6", "section 2.3.1"),
            "After fmi2Reset, an instance behaves like a new one.";
        SEPARATE: Error, "separate-instances", Standard("sections 3.3.1 and 4.3.1", "section 2.4.2"),
            "If canBeInstantiatedOnlyOncePerProcess is false, instances do not affect each other.";
        THREADS: Error, "any-thread", Practice("hosts step instances on the threads of a pool"),
            "Instances give the same results on any thread, and next to instances on other threads.";
        STATE: Error, "state", Standard("section 2.1.8", "section 2.2.7.4"),
            "If canGetAndSetFMUstate is true, restoring a state restores all variables.";
        SERIALIZED: Error, "serialized-state", Standard("section 2.1.8", "section 2.2.7.4"),
            "If canSerializeFMUstate is true, a state survives as bytes, also in another instance.";
        DAMAGED_STATE: Warning, "damaged-state",
            Practice("a state of another version or a truncated file is taken as a sound one"),
            "Bytes that are not a serialized state are refused.";
        DIRECTIONAL: Error, "directional-derivatives", Standard("section 2.1.9", "section 2.2.11"),
            "If providesDirectionalDerivative is true, derivatives are those of the outputs.";
        INPUT_DERIVATIVES: Error, "input-derivatives", Fmi2("section 4.2.1"),
            "If canInterpolateInputs is true, derivatives of inputs are accepted.";
        OUTPUT_DERIVATIVES: Error, "output-derivatives", Standard("section 4.2.1", "section 2.2.12"),
            "If maxOutputDerivativeOrder is not 0, derivatives of outputs are available.";
        DEPENDENCIES: Error, "true-dependencies", Standard("section 2.2.8", "section 2.4.8"),
            "An output depends directly on no input other than those that its dependencies list.";
        NAN: Error, "survives-nan",
            Practice("a diverging simulation passes NaN and infinity to every FMU in the loop"),
            "NaN and infinite inputs and times are refused or computed with; the FMU does not crash or hang.";
        STEP_ARGUMENTS: Warning, "step-arguments", Practice("a mistake of the host goes unnoticed"),
            "fmi2DoStep refuses negative and invalid step sizes and a time that is not the current one.";
        ORDER: Warning, "order-of-calls", Practice("a mistake of the host goes unnoticed"),
            "Calls in a wrong state return an error.";
        GET_AFTER_END: Error, "get-after-terminate", Standard("sections 3.2.3 and 4.2.4", "section 2.3.8"),
            "Values can be read after fmi2Terminate.";
        AFTER_ERROR: Warning, "after-error", Standard("section 2.1.6", "section 2.3.1"),
            "An instance that has returned fmi2Error can be reset and freed.";
        SURVIVES_MISUSE: Warning, "survives-misuse",
            Practice("a mistake in a host should end in a message, not in a crash"),
            "Wrong calls do not crash.";
        CATEGORY: Error, "log-category", Standard("section 2.1.5", "section 2.3.1"),
            "Messages have a category and a status of the standard.";
        DECLARED_CATEGORY: Warning, "log-category-declared", Standard("section 2.2.4", "section 2.4.5"),
            "The categories of messages are those of LogCategories.";
        LOG_ENVIRONMENT: Error, "log-environment", Standard("section 2.1.5", "section 2.3.1"),
            "Messages pass the component environment of their instance, and none is logged after it was freed.";
        LOGGING_OFF: Warning, "logging-off", Standard("section 2.1.5", "section 2.3.1"),
            "If logging is off, only problems are logged.";
        LONG_TEXTS: Error, "long-texts", Practice("a buffer that overflows is a security hole"),
            "Names and Strings of any length do not crash.";
        HEAP: Error, "heap", Practice("a damaged heap crashes later, somewhere else"),
            "The FMU writes only to memory that it owns, and frees it once.";
        INITIAL_OUTPUTS: Warning, "initial-outputs", Standard("section 2.1.6", "section 2.3.3"),
            "Outputs in initialization mode are those of the initial state, so that loops can be initialized.";
        LOG_FORMAT: Error, "log-format", Standard("section 2.1.5", "section 2.3.1"),
            "Text of the host is never used as a format of a message.";
        OUTPUT: Warning, "prints",
            Practice("hosts that write results to standard output mix them with the FMU's text"),
            "The FMU writes nothing to standard output and standard error.";
        DIRECTORY: Error, "working-directory", Practice("the host no longer finds its files"),
            "The working directory of the process stays as it is.";
        LOCALE: Error, "locale", Practice("the host reads 1,5 where it wrote 1.5"),
            "The locale of the process stays as it is.";
        ARITHMETIC: Error, "arithmetic", Practice("all computations of the host change"),
            "Rounding, subnormal numbers and floating-point traps of the process stay as they are.";
        SIGNALS: Warning, "signals", Practice("the host no longer handles its interrupts and crashes"),
            "The FMU installs no signal handlers.";
        ENVIRONMENT: Warning, "environment", Practice("they belong to the host and all of its threads"),
            "The environment variables, standard output and umask of the process stay as they are.";
        FILES: Warning, "files", Practice("the folder of the host fills with files"),
            "The FMU writes no files to the working directory and its own folder.";
        HANDLES: Warning, "handles", Practice("hosts that run thousands of instances run out of them"),
            "When an instance is freed, its files are closed and its threads and processes have ended.";
        STEADY_TIME: Warning, "steady-time", Practice("long runs do not end"),
            "A step at the end of a run takes about as long as one at the start.";
        MEMORY: Warning, "memory", Practice("parameter studies run out of memory"),
            "When an instance is freed, its memory is freed.";
        ARRAY_LENGTHS: Warning, "array-lengths",
            Practice("a host with another version of the XML reads and writes foreign memory"),
            "Functions refuse another number of values than the variables have.";
        SIZES: Error, "structural-parameters", Fmi3("section 2.4.7.4"),
            "Structural parameters can have every value between min and max, and size arrays.";
        ADJOINT: Error, "adjoint-derivatives", Fmi3("section 2.2.11"),
            "If providesAdjointDerivatives is true, they are those of the directional derivatives.";
        EVENT_MODE: Error, "event-mode", Fmi3("sections 4.2.1 and 4.4"),
            "If hasEventMode is true, the FMU runs in co-simulation with event mode.";
        EVENT_FLAGS: Error, "events-signalled", Fmi3("sections 4.2.1 and 4.4"),
            "A step that is not for event mode asks for no event handling; with event mode, discrete variables change at events only.";
        LAST_TIME: Error, "last-successful-time", Fmi3("section 4.2.1"),
            "lastSuccessfulTime is the time that a step has reached.";
        EARLY_RETURN: Error, "early-return-flag", Fmi3("section 4.4"),
            "If mightReturnEarlyFromDoStep is false, steps do not return early; no step does without the host's permission.";
        INTERMEDIATE: Error, "intermediate-update-flag", Fmi3("section 4.4"),
            "If providesIntermediateUpdate is false, the callback for intermediate updates is not called.";
        STATUS_TIME: Warning, "last-time-status", Practice("masters go on from this time after a discarded step"),
            "fmi2LastSuccessfulTime is the end of the last step.";
        COUNTS: Error, "states-counted", Standard("section 2.2.8", "section 2.4.8"),
            "The binary has as many continuous states and event indicators as the XML.";
        STATE_VARIABLES: Error, "state-variables", Standard("section 2.2.8", "section 2.4.8"),
            "The continuous states and their derivatives have the values and the order of the variables in the XML.";
        START_TIME: Error, "start-time", Standard("section 2.1.6", "section 2.3.2"),
            "The independent variable begins at the start time that the host passes.";
        START_REFUSED: Warning, "start-time-steps", Standard("section 2.1.6", "section 2.3.2"),
            "An FMU that begins within the default experiment takes steps from there.";
        TUNABLE_EFFECT: Warning, "tunable-effect", Standard("section 2.2.7", "section 2.4.7.4"),
            "A tunable parameter that is set in a run has an effect, if it has one before the run.";
        EVENTS: Error, "event-iteration", Standard("section 3.2.2", "section 2.3.5"),
            "The event iteration ends, and states, nominals and indicators are consistent.";
    }
}
