/* A rod that cools from both ends, an FMU of FMI 3.0 for model exchange: x[i]' = K (x[i - 1] - 2 x[i] + x[i + 1]).
 *
 * It counts evaluations of its equations and events: after each internal step if EVERY_STEP is 1, and every PERIOD s if
 * it is not 0.
 */
#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum { OK, ERROR = 3 };
#define N 30
enum { TIME, X, DX = X + N, EVALUATIONS = DX + N, EVENTS };
#define PI 3.14159265358979323846
/* The slowest part decays by exp(-t). */
#define K (0.5 / (1 - cos(PI / (N + 1))))

#ifndef EVERY_STEP
#define EVERY_STEP 0
#endif
#ifndef PERIOD
#define PERIOD 0.0
#endif

typedef struct {
    double time, states[N];
    int evaluations, events;
} Rod;

void *fmi3InstantiateModelExchange(const char *name, const char *token) {
    if (!name || strcmp(token, "{rod}")) return NULL;
    Rod *c = calloc(1, sizeof *c);
    for (int i = 0; i < N; i++) c->states[i] = sin(PI * (i + 1) / (N + 1));
    c->events = -1; /* the first event is the start */
    return c;
}

void fmi3FreeInstance(Rod *c) { free(c); }

int fmi3EnterInitializationMode(Rod *c, bool has_tolerance, double tolerance, double start) {
    (void)has_tolerance, (void)tolerance;
    return c->time = start, OK;
}

int fmi3ExitInitializationMode(Rod *c) { return (void)c, OK; }

int fmi3Terminate(Rod *c) { return (void)c, OK; }

int fmi3EnterEventMode(Rod *c) { return (void)c, OK; }

int fmi3EnterContinuousTimeMode(Rod *c) { return (void)c, OK; }

int fmi3SetTime(Rod *c, double time) { return c->time = time, OK; }

int fmi3GetNumberOfContinuousStates(Rod *c, size_t *n) { return (void)c, *n = N, OK; }

int fmi3GetNumberOfEventIndicators(Rod *c, size_t *n) { return (void)c, *n = 1, OK; }

int fmi3GetEventIndicators(Rod *c, double *values, size_t n) {
    return (void)c, (void)n, values[0] = 1, OK;
}

int fmi3GetContinuousStates(Rod *c, double *states, size_t n) {
    return memcpy(states, c->states, n * sizeof *states), OK;
}

int fmi3SetContinuousStates(Rod *c, const double *states, size_t n) {
    return memcpy(c->states, states, n * sizeof *states), OK;
}

int fmi3GetContinuousStateDerivatives(Rod *c, double *derivatives, size_t n) {
    c->evaluations++;
    for (size_t i = 0; i < n; i++) {
        double before = i ? c->states[i - 1] : 0, after = i + 1 < n ? c->states[i + 1] : 0;
        derivatives[i] = K * (before - 2 * c->states[i] + after);
    }
    return OK;
}

int fmi3GetNominalsOfContinuousStates(Rod *c, double *nominals, size_t n) {
    for (size_t i = 0; i < n; i++) nominals[i] = 1;
    return (void)c, OK;
}

int fmi3CompletedIntegratorStep(Rod *c, bool no_set, bool *enter_event_mode, bool *terminate) {
    (void)c, (void)no_set;
    *enter_event_mode = EVERY_STEP;
    *terminate = false;
    return OK;
}

int fmi3UpdateDiscreteStates(Rod *c, bool *again, bool *terminate, bool *nominals_changed,
                             bool *values_changed, bool *has_next, double *next) {
    *again = *terminate = *nominals_changed = *values_changed = false;
    c->events++;
    *has_next = PERIOD > 0;
    if (*has_next) *next = (c->events + 1) * PERIOD;
    return OK;
}

int fmi3GetFloat64(Rod *c, const unsigned *references, size_t n, double *values, size_t count) {
    for (size_t i = 0; i < n && i < count; i++) {
        if (references[i] != TIME && (references[i] < X || references[i] >= DX)) return ERROR;
        values[i] = references[i] == TIME ? c->time : c->states[references[i] - X];
    }
    return OK;
}

int fmi3GetInt32(Rod *c, const unsigned *references, size_t n, int32_t *values, size_t count) {
    for (size_t i = 0; i < n && i < count; i++)
        values[i] = references[i] == EVENTS ? c->events : c->evaluations;
    return OK;
}
