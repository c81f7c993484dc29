/* A PI controller with its state in global variables, as much old and generated code has it, and an FMU for
 * co-simulation around it that does not say so: u = 2 e + the sum of e h, e = w - y. It takes calls in any order.
 *
 * -DKEEPS does not set the variables of the controller when it starts, -DSTARTS_ONCE refuses to start it twice, and
 * -DRUNS_ALONE aborts if it is started before it has ended.
 */
#include <stdlib.h>
#include <string.h>

#include "stubs.h"

/* --- the controller ------------------------------------------------------------------------------- */

static double integral, control;
static int starts, runs;

static int pi_start(void) {
#ifdef STARTS_ONCE
    if (starts) return 0;
#endif
#ifdef RUNS_ALONE
    if (runs) abort();
#endif
#ifndef KEEPS
    integral = control = 0;
#endif
    starts++;
    return runs = 1;
}

static void pi_step(double w, double y, double h) {
    integral += (w - y) * h;
    control = 2 * (w - y) + integral;
}

static void pi_end(void) { runs = 0; }

/* --- the FMU -------------------------------------------------------------------------------------- */

enum { W, Y, U, REALS };

typedef struct {
    double inputs[2];
    int is_started;
} Instance;

EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORT const char *fmi2GetVersion(void) { return "2.0"; }
EXPORT int fmi2SetDebugLogging(void) { return OK; }
EXPORT int fmi2SetupExperiment(void) { return OK; }

EXPORT Instance *fmi2Instantiate(const char *name, int type, const char *guid) {
    (void)name, (void)type;
    return strcmp(guid, "{legacy}") ? NULL : calloc(1, sizeof(Instance));
}

EXPORT int fmi2Reset(Instance *c) {
    if (c->is_started) pi_end();
    *c = (Instance){0};
    return OK;
}

EXPORT void fmi2FreeInstance(Instance *c) {
    if (c) fmi2Reset(c);
    free(c);
}

EXPORT int fmi2EnterInitializationMode(Instance *c) { return (c->is_started = pi_start()) ? OK : ERROR; }
EXPORT int fmi2ExitInitializationMode(void) { return OK; }
EXPORT int fmi2Terminate(void) { return OK; }

EXPORT int fmi2DoStep(Instance *c, double time, double step) {
    (void)time;
    pi_step(c->inputs[W], c->inputs[Y], step);
    return OK;
}

EXPORT int fmi2GetReal(Instance *c, References references, size_t n, double *values) {
    for (size_t i = 0; i < n; i++) {
        if (references[i] >= REALS) return ERROR;
        values[i] = references[i] == U ? control : c->inputs[references[i]];
    }
    return OK;
}

EXPORT int fmi2SetReal(Instance *c, References references, size_t n, const double *values) {
    for (size_t i = 0; i < n; i++) {
        if (references[i] >= U) return ERROR;
        c->inputs[references[i]] = values[i];
    }
    return OK;
}

STUB(fmi2GetInteger)
STUB(fmi2GetBoolean)
STUB(fmi2GetString)
STUB(fmi2SetInteger)
STUB(fmi2SetBoolean)
STUB(fmi2SetString)
OPTIONAL_STUBS
