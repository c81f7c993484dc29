/* An FMU for co-simulation with the outputs y = t, r = 1, e = 1 - t, u = t, which does something
 * forbidden in the step from the time `at`, or in fmi2EnterInitializationMode if `at` is negative.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include "stubs.h"

enum { Y, R, E, U, AT, REALS };
enum { NOTHING, CRASH, ABORT, EXIT, EXIT_AT_ONCE, HANG, FILL, WRITE, PRINT, FAIL, TELL, END, FORK, START, FATALLY };

typedef struct {
    const Callbacks *callbacks;
    double reals[REALS];
    int fault;
} Instance;

static int fault(Instance *c) {
    switch (c->fault) {
    case TELL:
        c->callbacks->logger(c->callbacks->environment, "", OK, "faulty", "about to %s", "crash");
        /* fall through */
    case CRASH:
        *(volatile int *)16 = 1;
        break;
    case ABORT:
        abort();
    case EXIT:
        exit(0);
    case EXIT_AT_ONCE:
        _exit(3);
    case HANG:
        for (;;) sleep(1);
    case FILL:
        for (;;) memset(malloc(1 << 20), 1, 1 << 20);
    case WRITE:
        for (volatile char *p = (volatile char *)c;; p++) *p = 0x55;
    case PRINT:
        printf("0,1,2,3\n");
        fflush(stdout);
        break;
    case FAIL:
        return ERROR;
    case FATALLY:
        return FATAL;
    case FORK: /* returns in both processes, in the first one when the second has ended */
        for (int second = fork(), ended = 0; second > 0 && ended != second;) ended = waitpid(second, NULL, 0);
        break;
    case START: /* of a program, which has all files and variables of this process */
        return system(getenv("FAULTY_COMMAND")) == 0 ? OK : ERROR;
    case END:
        c->callbacks->logger(c->callbacks->environment, "", OK, "faulty", "it has %s", "arrived");
        return DISCARD;
    }
    return OK;
}

EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORT const char *fmi2GetVersion(void) { return "2.0"; }
EXPORT int fmi2SetDebugLogging(void) { return OK; }

EXPORT Instance *fmi2Instantiate(const char *name, int type, const char *guid, const char *resources,
                                 const Callbacks *callbacks) {
    (void)name, (void)type, (void)guid, (void)resources;
    Instance *c = calloc(1, sizeof *c);
    c->callbacks = callbacks;
    return c;
}

EXPORT void fmi2FreeInstance(Instance *c) { free(c); }

static void calculate(Instance *c, double time) {
    c->reals[Y] = c->reals[U] = time;
    c->reals[R] = 1;
    c->reals[E] = 1 - time;
}

EXPORT int fmi2SetupExperiment(Instance *c, int tolerance_defined, double tolerance, double start) {
    (void)tolerance_defined, (void)tolerance;
    calculate(c, start);
    return OK;
}

EXPORT int fmi2EnterInitializationMode(Instance *c) { return c->reals[AT] < 0 ? fault(c) : OK; }
EXPORT int fmi2ExitInitializationMode(Instance *c) { return c ? OK : ERROR; }
EXPORT int fmi2Terminate(Instance *c) { return c ? OK : ERROR; }

EXPORT int fmi2GetReal(Instance *c, References references, size_t n, double *values) {
    for (size_t i = 0; i < n; i++) values[i] = c->reals[references[i]];
    return OK;
}

EXPORT int fmi2SetReal(Instance *c, References references, size_t n, const double *values) {
    for (size_t i = 0; i < n; i++) c->reals[references[i]] = values[i];
    return OK;
}

EXPORT int fmi2SetInteger(Instance *c, References references, size_t n, const int *values) {
    for (size_t i = 0; i < n && references[i] == 0; i++) c->fault = values[i];
    return OK;
}

EXPORT int fmi2DoStep(Instance *c, double time, double step) {
    calculate(c, time + step);
    double at = c->reals[AT];
    return at >= 0 && time > at - step / 2 && time < at + step / 2 ? fault(c) : OK;
}

EXPORT int fmi2GetBooleanStatus(const Instance *c, int kind, int *value) {
    *value = kind == TERMINATED && c->fault == END;
    return OK;
}

/* The time of the last step, which was completed although the simulation ends. */
EXPORT int fmi2GetRealStatus(const Instance *c, int kind, double *value) {
    *value = c->reals[Y];
    return kind == LAST_SUCCESSFUL_TIME ? OK : ERROR;
}

STUB(fmi2Reset)
STUB(fmi2GetInteger)
STUB(fmi2GetBoolean)
STUB(fmi2SetBoolean)
STUB(fmi2GetString)
STUB(fmi2SetString)
