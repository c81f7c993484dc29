/* A small FMU for model exchange and co-simulation: x' = u - x, y = x.
 *
 * Valid by default. Each macro FAULT_... causes a fault that `cargo fmu validate` must find.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2.h"

enum { X, DER_X, U, Y };

typedef struct {
    double time, x, u, rate;
    int steps;
} Instance;

#define EXPORT __attribute__((visibility("default")))
#define STUB(name) \
    EXPORT int name(void) { return ERROR; }

static double derivative(const Instance *c) { return c->u - c->x; }

static void start(Instance *c) {
    memset(c, 0, sizeof *c);
    c->x = 1;
#ifdef FAULT_START
    c->x = 1.5;
#endif
}

EXPORT const char *fmi2GetTypesPlatform(void) {
#ifdef FAULT_PLATFORM
    return "other";
#else
    return "default";
#endif
}

EXPORT const char *fmi2GetVersion(void) {
#ifdef FAULT_VERSION
    return "1.0";
#else
    return "2.0";
#endif
}

EXPORT Component fmi2Instantiate(const char *name, int type, const char *guid) {
    (void)name, (void)type;
#ifdef FAULT_EXIT
    exit(0);
#endif
#ifdef FAULT_OTHER_GUID
    return NULL;
#endif
#ifndef FAULT_ANY_GUID
    if (strcmp(guid, "{decay}")) return NULL;
#endif
#ifdef FAULT_SHARED
    static Instance shared;
    Instance *c = &shared;
#else
    Instance *c = malloc(sizeof *c);
#endif
    start(c);
    return c;
}

EXPORT void fmi2FreeInstance(Component c) {
#ifndef FAULT_SHARED
    free(c);
#else
    (void)c;
#endif
}

EXPORT int fmi2SetDebugLogging(void) { return OK; }

EXPORT int fmi2SetupExperiment(Instance *c, int tolerance_defined, double tolerance, double time) {
    (void)tolerance_defined, (void)tolerance;
    c->time = time;
    return OK;
}

EXPORT int fmi2EnterInitializationMode(Instance *c) {
    (void)c;
#ifdef FAULT_HANG
    for (volatile int forever = 1; forever;) {}
#endif
    return OK;
}

EXPORT int fmi2ExitInitializationMode(Instance *c) { return c ? OK : ERROR; }
EXPORT int fmi2Terminate(Instance *c) { return c ? OK : ERROR; }

EXPORT int fmi2Reset(Instance *c) {
#ifdef FAULT_RESET
    c->u = 0;
#else
    start(c);
#endif
    return OK;
}

EXPORT int fmi2GetReal(Instance *c, References references, size_t n, double *values) {
    for (size_t i = 0; i < n; i++) {
        switch (references[i]) {
        case X: values[i] = c->x; break;
        case DER_X: values[i] = derivative(c); break;
        case U: values[i] = c->u; break;
#ifdef FAULT_GET
        case Y: return ERROR;
#elif defined FAULT_NAN
        case Y: values[i] = c->steps ? NAN : 1; break;
#else
        case Y: values[i] = c->x; break;
#endif
        default: return ERROR;
        }
    }
    return OK;
}

EXPORT int fmi2SetReal(Instance *c, References references, size_t n, const double *values) {
    for (size_t i = 0; i < n; i++) {
        if (references[i] == U) c->u = values[i];
        else if (references[i] == X) c->x = values[i];
        else return ERROR;
    }
    return OK;
}

STUB(fmi2GetInteger)
STUB(fmi2GetBoolean)
STUB(fmi2GetString)
STUB(fmi2SetInteger)
STUB(fmi2SetBoolean)
STUB(fmi2SetString)

EXPORT int fmi2GetFMUstate(Instance *c, Instance **state) {
#ifdef FAULT_NO_STATE
    return ERROR;
#endif
    if (!*state) *state = malloc(sizeof **state);
    **state = *c;
    return OK;
}

EXPORT int fmi2SetFMUstate(Instance *c, Instance *state) {
#ifdef FAULT_STATE
    c->time = state->time;
#else
    *c = *state;
#endif
    return OK;
}

EXPORT int fmi2FreeFMUstate(Instance *c, Instance **state) {
    (void)c;
    free(*state);
#ifndef FAULT_FREE_STATE
    *state = NULL;
#endif
    return OK;
}

EXPORT int fmi2SerializedFMUstateSize(Instance *c, Instance *state, size_t *size) {
    (void)c, (void)state;
#ifdef FAULT_HUGE_STATE
    *size = (size_t)-1;
#else
    *size = sizeof(Instance);
#endif
    return OK;
}

EXPORT int fmi2SerializeFMUstate(Instance *c, Instance *state, char *bytes, size_t size) {
    (void)c;
#ifndef FAULT_SERIALIZE
    memcpy(bytes, state, size);
#else
    (void)state, (void)bytes, (void)size;
#endif
    return OK;
}

EXPORT int fmi2DeSerializeFMUstate(Instance *c, const char *bytes, size_t size, Instance **state) {
    (void)c;
    if (size != sizeof **state) return ERROR;
    *state = malloc(sizeof **state);
    memcpy(*state, bytes, size);
    return OK;
}

EXPORT int fmi2GetDirectionalDerivative(Instance *c, References unknowns, size_t n, References knowns,
                                        size_t m, const double *seed, double *values) {
    (void)c, (void)unknowns, (void)knowns, (void)m, (void)seed;
#ifdef FAULT_DERIVATIVE
    return ERROR;
#endif
    for (size_t i = 0; i < n; i++) values[i] = 0;
    return OK;
}

/* Co-simulation. */

EXPORT int fmi2DoStep(Instance *c, double time, double step) {
#ifdef FAULT_CRASH
    *(volatile int *)8 = 0;
#endif
#ifdef FAULT_STEP
    return DISCARD;
#endif
#ifdef FAULT_STEP_SIZE
    if (fabs(step - 0.1) > 1e-9) return ERROR;
#endif
#ifdef FAULT_STATUS
    return 77;
#endif
    if (fabs(time - c->time) > 1e-9) return ERROR;
    c->x += step * derivative(c);
    c->time += step;
    c->steps++;
    return OK;
}

EXPORT int fmi2SetRealInputDerivatives(Instance *c, References references, size_t n, const int *orders,
                                       const double *values) {
    (void)c, (void)references, (void)n, (void)orders, (void)values;
#ifdef FAULT_INTERPOLATE
    return ERROR;
#endif
    return OK;
}

EXPORT int fmi2GetRealOutputDerivatives(Instance *c, References references, size_t n,
                                        const int *orders, double *values) {
    (void)references, (void)orders;
#ifdef FAULT_OUTPUT_DERIVATIVE
    return ERROR;
#endif
    for (size_t i = 0; i < n; i++) values[i] = derivative(c);
    return OK;
}

#ifndef FAULT_MISSING
STUB(fmi2CancelStep)
#endif
STUB(fmi2GetStatus)
STUB(fmi2GetRealStatus)
STUB(fmi2GetIntegerStatus)
STUB(fmi2GetBooleanStatus)
STUB(fmi2GetStringStatus)

/* Model exchange. */

EXPORT int fmi2EnterEventMode(Instance *c) { return c ? OK : ERROR; }

EXPORT int fmi2NewDiscreteStates(Instance *c, int *info) {
    (void)c;
    memset(info, 0, 5 * sizeof *info);
#ifdef FAULT_ROUNDS
    info[0] = 1;
#endif
    return OK;
}

EXPORT int fmi2EnterContinuousTimeMode(Instance *c) { return c ? OK : ERROR; }

EXPORT int fmi2CompletedIntegratorStep(Instance *c, int last, int *event, int *terminate) {
    (void)c, (void)last;
    *event = *terminate = 0;
    return OK;
}

EXPORT int fmi2SetTime(Instance *c, double time) {
    c->time = time;
    return OK;
}

EXPORT int fmi2SetContinuousStates(Instance *c, const double *states, size_t n) {
    if (n != 1) return ERROR;
    c->x = states[0];
    return OK;
}

EXPORT int fmi2GetDerivatives(Instance *c, double *derivatives, size_t n) {
    if (n != 1) return ERROR;
    derivatives[0] = derivative(c);
    return OK;
}

EXPORT int fmi2GetEventIndicators(Instance *c, double *indicators, size_t n) {
    (void)c, (void)indicators;
    return n == 0 ? OK : ERROR;
}

EXPORT int fmi2GetContinuousStates(Instance *c, double *states, size_t n) {
    if (n != 1) return ERROR;
    states[0] = c->x;
    return OK;
}

EXPORT int fmi2GetNominalsOfContinuousStates(Instance *c, double *nominals, size_t n) {
    (void)c;
    if (n != 1) return ERROR;
    nominals[0] = 1;
    return OK;
}
