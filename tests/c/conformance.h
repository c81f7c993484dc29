/* The defects that `conformance.c` can be compiled with, and the side effects that some of them have.
 *
 * `-DDEFECT=NAME` plants one defect. Without it the FMU has none.
 */
#ifndef CONFORMANCE_H
#define CONFORMANCE_H

#include <errno.h>
#include <fcntl.h>
#include <fenv.h>
#include <float.h>
#include <limits.h>
#include <locale.h>
#include <math.h>
#include <pthread.h>
#include <signal.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>
#include <xmmintrin.h>

enum Defect {
    NO_DEFECT,
    /* Version, instantiation, end. */
    WRONG_PLATFORM, WRONG_VERSION, GUID_REFUSED, ANY_GUID_TAKEN, EXIT_IN_INSTANTIATE,
    SECOND_INSTANCE_REFUSED, ONE_INSTANCE_FOR_ALL, EIGHT_INSTANCES_EVER, LONG_NAME_OVERFLOWS,
    DEPENDS_ON_INSTANCE_NAME, DEPENDS_ON_PREVIOUS_INSTANCE, DEPENDS_ON_RESOURCE_PATH,
    KEEPS_ARGUMENT_STRINGS, KEEPS_CALLBACK_POINTER, FREE_NULL_CRASHES, FREE_LOGS_AFTER,
    FREE_CRASHES, UNLOAD_CRASHES, MISSING_FUNCTION,
    /* State machine and arguments. */
    STEP_BEFORE_INIT_TAKEN, DOUBLE_INIT_TAKEN, STEP_AFTER_TERMINATE_TAKEN, TERMINATE_ABORTS,
    TERMINATE_LOSES_RESULTS, GET_AFTER_TERMINATE_REFUSED, STEP_AFTER_ERROR_WRONG, EXITS_ON_ERROR,
    NEGATIVE_STEP_TAKEN, WRONG_TIME_TAKEN, PAST_STOP_TIME_TAKEN, STEP_STATUS_UNKNOWN,
    STEP_DISCARDS, STEP_PENDING, STEP_WARNS, STEP_ERROR_WITHOUT_MESSAGE, DISCARD_THEN_LOST,
    LAST_TIME_WRONG, GET_STATUS_CRASHES, CANCEL_STEP_CRASHES, HANG_IN_INIT, HANG_IN_STEP,
    HANG_IN_TERMINATE, NVR_ZERO_CRASHES, PARTIAL_SET, SET_ERROR_RETURNS_OK,
    /* Reset and independence of instances. */
    RESET_KEEPS_STATE, RESET_KEEPS_PARAMETERS, RESET_KEEPS_INPUT, RESET_KEEPS_STRING,
    RESET_KEEPS_TIME, RESET_KEEPS_PHASE, RESET_REFUSED, RESET_CRASHES, SHARED_STATIC,
    SHARED_STRING_BUFFER, TWO_THREADS_RACE, SECOND_THREAD_WRONG,
    /* FMU state. */
    GET_STATE_REFUSED, SET_STATE_IGNORED, STATE_LOSES_DISCRETE, STATE_LOSES_CONTINUOUS,
    STATE_LOSES_TIME, STATE_LOSES_PARAMETER, STATE_LOSES_INPUT, STATE_LOSES_STRING,
    STATE_LOSES_PHASE, STATE_ALIASES_INSTANCE, STATE_SHARED, STATE_USED_UP, STATE_OVERWRITE_LEAKS,
    FREE_STATE_KEEPS_POINTER, FREE_STATE_NULL_CRASHES, FREE_STATE_LEAKS, DAMAGED_STATE_TAKEN,
    DAMAGED_STATE_CRASHES, TRUNCATED_STATE_TAKEN, STATE_SIZE_TOO_SMALL, STATE_SIZE_HUGE,
    SERIALIZE_WRITES_NOTHING, STATE_BYTES_DIFFER, STATE_HOLDS_POINTER,
    /* Variables. */
    WRONG_START, UNKNOWN_REFERENCE_READ, UNKNOWN_REFERENCE_SET, WRONG_TYPE_REFERENCE_TAKEN,
    OUTPUT_REFUSED, OUTPUT_SETTABLE, CONSTANT_SETTABLE, CONSTANT_CHANGES,
    FIXED_PARAMETER_SETTABLE_LATER, TUNABLE_REFUSED, TUNABLE_IGNORED, PARAMETER_IGNORED,
    CALCULATED_PARAMETER_STALE, SET_IN_INIT_IGNORED, OUTPUT_NOT_UPDATED_IN_INIT, OUTPUT_STALE,
    STRING_INPUT_IGNORED, STRING_FREED_TOO_EARLY, STRING_NULL, STRING_NOT_UTF8,
    LONG_STRING_OVERFLOWS, INTEGER_TRUNCATED, REAL_TRUNCATED, BOOLEAN_IS_2,
    ENUMERATION_OUT_OF_RANGE, OUTPUT_OUTSIDE_MIN_MAX, ALIAS_DIFFERS, GET_HAS_SIDE_EFFECTS,
    GET_ORDER_MATTERS, GET_WRITES_PAST_END, SET_WRITES_ARGUMENT, UNDECLARED_DEPENDENCY,
    NAN_OUTPUT, NAN_OUTPUT_LATE, INFINITE_OUTPUT, NAN_TAKEN, HANG_ON_NAN, ABORT_ON_NAN, CRASH_ON_INF,
    /* Results. */
    DEPENDS_ON_STOP_TIME, DEPENDS_ON_STEP_SIZE, DEPENDS_ON_LOGGING,
    DEPENDS_ON_WALL_CLOCK, DEPENDS_ON_ADDRESS, DEPENDS_ON_RANDOM, DEPENDS_ON_ENVIRONMENT,
    UNINITIALISED_FIELD, START_TIME_IGNORED, SAMPLE_NEEDS_EXACT_TIME, ONE_SAMPLE_PER_STEP,
    ONE_STEP_SIZE_ONLY, SAMPLES_OVERFLOW, CRASH_IN_STEP, CRASH_LATER, ABORT_LATER, EXIT_LATER,
    FATAL_LATER, STACK_OVERFLOW_LATER, WRONG_DIRECTIONAL_DERIVATIVE,
    WRONG_DIRECTIONAL_DERIVATIVE_LATE, DIRECTIONAL_DERIVATIVE_REFUSED,
    OUTPUT_DERIVATIVE_REFUSED, OUTPUT_DERIVATIVE_WRONG, INPUT_DERIVATIVE_REFUSED,
    INPUT_DERIVATIVE_IGNORED,
    /* Memory and time. */
    LEAK_PER_INSTANCE, LEAK_PER_CALLBACK, LEAK_PER_STEP, LEAK_PER_GET, FILLS_MEMORY, WRITES_AFTER_FREE,
    DOUBLE_FREE, OVERFLOWS_HEAP, STEPS_SLOW_DOWN,
    /* The process. */
    PRINTS_TO_STDOUT, PRINTS_TO_STDERR, CLOSES_STDOUT, CHANGES_DIRECTORY, CHANGES_LOCALE,
    CHANGES_ROUNDING_MODE, SETS_FLUSH_TO_ZERO, ENABLES_FP_EXCEPTIONS, CHANGES_UMASK, CHANGES_RANDOM_SEED,
    INSTALLS_SIGNAL_HANDLER, LEAVES_THREAD, LEAVES_FILE_OPEN, WRITES_FILE_IN_CWD, WRITES_RESOURCES,
    SETS_ENVIRONMENT, LEAVES_CHILD, SETS_ALARM,
    /* Logging. */
    NULL_LOGGER_CALLED, LOGS_WITHOUT_CONSENT, LOG_CATEGORY_IGNORED, LOGGER_FORMAT_FROM_DATA,
    LOGS_NULL_CATEGORY, LOGS_UNDECLARED_CATEGORY, LOGS_WRONG_ENVIRONMENT, LOGS_WRONG_NAME,
    LOGS_WRONG_STATUS, UNKNOWN_CATEGORY_CRASHES, LOGGING_REFUSED,
    /* Model exchange. */
    NEVER_LEAVES_EVENT_ITERATION, EVENT_INFO_NOT_WRITTEN, NEXT_EVENT_IN_PAST, NEXT_EVENT_MISSING,
    STATE_CHANGE_NOT_SAID, EVENT_INDICATOR_CHANGES_ON_READ, EVENT_INDICATOR_CONSTANT,
    EVENT_INDICATOR_NAN, DERIVATIVES_USE_STALE_STATE, DERIVATIVES_USE_STALE_INPUT,
    DERIVATIVES_HAVE_SIDE_EFFECTS, WRONG_DERIVATIVE_LATE, DERIVATIVES_SWAPPED, STATES_SWAPPED,
    WRONG_STATE_COUNT_TAKEN, COMPLETED_STEP_MISSING, TIME_BACK_REFUSED, NOMINAL_ZERO, NOMINAL_NAN,
    DISCRETE_CHANGES_IN_CONTINUOUS_TIME, ENTER_EVENT_MODE_REFUSED, TERMINATES_SIMULATION,
};

#ifndef DEFECT
#define DEFECT NO_DEFECT
#endif

/* Whether the FMU is compiled with a defect. */
#define HAS(defect) (DEFECT == defect)

static inline void crash(void) { *(volatile int *)8 = 0; }

static inline void hang(void) {
    for (volatile int forever = 1; forever;) {}
}

/* Allocates memory, uses it and forgets it. */
static inline void leak(size_t size) {
    char *volatile block = malloc(size);
    if (block) memset(block, 1, size);
}

static inline int recurse(volatile char *outer) {
    volatile char frame[4096];
    frame[0] = outer ? *outer : 1;
    return frame[0] ? recurse(frame) + frame[0] : 0;
}

static inline void ignore_signal(int number) { (void)number; }

static inline void *wait_forever(void *argument) {
    for (;;) pause();
    return argument;
}

static inline void write_file(const char *path) {
    FILE *file = fopen(path, "w");
    if (!file) return;
    fputs("written by the FMU\n", file);
    fclose(file);
}

/* What a defect does to the process when an instance is made. */
static inline void change_process(const char *resources) {
    switch (DEFECT) {
    case EXIT_IN_INSTANTIATE: exit(0);
    case CLOSES_STDOUT: close(STDOUT_FILENO); break;
    case CHANGES_DIRECTORY: if (chdir("/")) abort(); break;
    case CHANGES_LOCALE: setlocale(LC_ALL, "C.UTF-8"); break;
    case CHANGES_ROUNDING_MODE: fesetround(FE_UPWARD); break;
    case SETS_FLUSH_TO_ZERO: _MM_SET_FLUSH_ZERO_MODE(_MM_FLUSH_ZERO_ON); break;
    case ENABLES_FP_EXCEPTIONS: feenableexcept(FE_DIVBYZERO | FE_INVALID | FE_OVERFLOW); break;
    case CHANGES_UMASK: umask(0); break;
    case CHANGES_RANDOM_SEED: srand(1); srandom(1); break;
    case INSTALLS_SIGNAL_HANDLER:
        signal(SIGSEGV, ignore_signal);
        signal(SIGINT, ignore_signal);
        break;
    case LEAVES_THREAD: {
        pthread_t thread;
        pthread_create(&thread, NULL, wait_forever, NULL);
        break;
    }
    case LEAVES_CHILD:
        if (!fork()) {
            execlp("sleep", "sleep", "30", (char *)NULL);
            _exit(1);
        }
        break;
    case SETS_ALARM: alarm(1); break;
    case LEAVES_FILE_OPEN: if (open("/dev/null", O_RDONLY) < 0) abort(); break;
    case WRITES_FILE_IN_CWD: write_file("conformance.log"); break;
    case WRITES_RESOURCES: {
        char path[PATH_MAX];
        if (!resources || strncmp(resources, "file://", 7)) break;
        snprintf(path, sizeof path, "%s/conformance.log", resources + 7);
        write_file(path);
        break;
    }
    case SETS_ENVIRONMENT: setenv("CONFORMANCE", "1", 1); break;
    default: break;
    }
}

/* What a defect does in a step that ends at `time` [s]. */
static inline void disturb_step(double time) {
    static double slow[1000];
    switch (DEFECT) {
    case CRASH_IN_STEP: crash(); break;
    case CRASH_LATER: if (time > 0.5) crash(); break;
    case ABORT_LATER: if (time > 0.5) abort(); break;
    case EXIT_LATER: if (time > 0.5) exit(0); break;
    case STACK_OVERFLOW_LATER: if (time > 0.5) recurse(NULL); break;
    case HANG_IN_STEP: if (time > 0.5) hang(); break;
    case PRINTS_TO_STDOUT: printf("t = %g\n", time); fflush(stdout); break;
    case PRINTS_TO_STDERR: fprintf(stderr, "t = %g\n", time); break;
    case LEAK_PER_STEP: leak(1000); break;
    case FILLS_MEMORY: if (time > 0.5) for (;;) leak(1 << 20); break;
    case OVERFLOWS_HEAP: {
        volatile char *block = malloc(40);
        for (int i = 0; block && i < 64; i++) block[i] = 0x55;
        free((void *)block);
        break;
    }
    case DOUBLE_FREE: {
        void *volatile block = malloc(2000);
        free(block);
        free(block);
        break;
    }
    case STEPS_SLOW_DOWN: {
        static long steps;
        steps += 10;
        for (long i = 0; i < steps * steps; i++) slow[i % 1000] += 1;
        break;
    }
    default: break;
    }
}

#endif
