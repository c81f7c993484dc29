/* An FMU for model exchange and co-simulation: a body between springs, and an element that outputs its input at once.
 *
 *     x' = v          m v' = f - d v - k x - c (x - p)         force = c (x - p)
 *     y = (gain + curve u) u + bias                            on = b, or not b if invert is set
 *
 * Co-simulation holds the inputs, takes Runge-Kutta steps of 0.2 ms at most, and computes outputs in steps only
 * (before the first one, at once). It counts its
 * steps.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "stubs.h"

enum { TIME, X, V, DER_X, DER_V, F, P, M, D, K, C, FORCE, U, Y, GAIN, CURVE, BIAS, REALS };
enum { STEPS, INTEGERS };
enum { B, ON, INVERT, BOOLEANS };

typedef struct {
    double reals[REALS];
    int integers[INTEGERS], booleans[BOOLEANS];
    int steps_by_itself, is_running;
} Body;

EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORT const char *fmi2GetVersion(void) { return "2.0"; }
EXPORT int fmi2SetDebugLogging(void) { return OK; }

EXPORT int fmi2Reset(Body *b) {
    const int steps_by_itself = b->steps_by_itself;
    memset(b, 0, sizeof *b);
    b->steps_by_itself = steps_by_itself;
    b->reals[M] = 1;
    return OK;
}

EXPORT Body *fmi2Instantiate(const char *name, int kind, const char *guid) {
    if (!name || strcmp(guid, "{body}")) return NULL;
    Body *b = malloc(sizeof *b);
    b->steps_by_itself = kind;
    return fmi2Reset(b), b;
}

EXPORT void fmi2FreeInstance(Body *b) { free(b); }

EXPORT int fmi2SetupExperiment(Body *b, int has_tolerance, double tolerance, double start) {
    (void)has_tolerance, (void)tolerance;
    return b->reals[TIME] = start, OK;
}

/* --- the equations -------------------------------------------------------------------------------- */

static double acceleration(const double *r, double x, double v) {
    return (r[F] - r[D] * v - r[K] * x - r[C] * (x - r[P])) / r[M];
}

static void evaluate(Body *b) {
    double *r = b->reals;
    r[DER_X] = r[V], r[DER_V] = acceleration(r, r[X], r[V]);
    r[FORCE] = r[C] * (r[X] - r[P]);
    r[Y] = (r[GAIN] + r[CURVE] * r[U]) * r[U] + r[BIAS];
    b->booleans[ON] = b->booleans[B] != b->booleans[INVERT];
}

static void move(Body *b, double h) {
    double *r = b->reals, x[4], v[4];
    x[0] = r[V], v[0] = acceleration(r, r[X], r[V]);
    for (int i = 1; i < 4; i++) {
        const double part = i < 3 ? h / 2 : h;
        x[i] = r[V] + part * v[i - 1];
        v[i] = acceleration(r, r[X] + part * x[i - 1], x[i]);
    }
    r[X] += h / 6 * (x[0] + 2 * x[1] + 2 * x[2] + x[3]);
    r[V] += h / 6 * (v[0] + 2 * v[1] + 2 * v[2] + v[3]);
}

EXPORT int fmi2EnterInitializationMode(Body *b) { return (void)b, OK; }
EXPORT int fmi2ExitInitializationMode(Body *b) { return evaluate(b), b->is_running = 1, OK; }
EXPORT int fmi2Terminate(Body *b) { return (void)b, OK; }

EXPORT int fmi2DoStep(Body *b, double time, double step) {
    if (!(step > 0) || fabs(time - b->reals[TIME]) > 1e-9) return ERROR;
    const int count = (int)ceil(step / 2e-4);
    for (int i = 0; i < count; i++) move(b, step / count);
    b->reals[TIME] = time + step;
    b->integers[STEPS]++;
    return evaluate(b), OK;
}

/* --- values ---------------------------------------------------------------------------------------- */

#define ACCESS(type, value, values_of, count)                                                      \
    EXPORT int fmi2Get##type(Body *b, References references, size_t n, value *values) {            \
        if (!b->steps_by_itself || !b->is_running) evaluate(b);                                    \
        for (size_t i = 0; i < n; i++) {                                                           \
            if (references[i] >= count) return ERROR;                                              \
            values[i] = b->values_of[references[i]];                                               \
        }                                                                                          \
        return OK;                                                                                 \
    }                                                                                              \
    EXPORT int fmi2Set##type(Body *b, References references, size_t n, const value *values) {      \
        for (size_t i = 0; i < n; i++) {                                                           \
            if (references[i] >= count) return ERROR;                                              \
            b->values_of[references[i]] = values[i];                                               \
        }                                                                                          \
        return OK;                                                                                 \
    }

ACCESS(Real, double, reals, REALS)
ACCESS(Integer, int, integers, INTEGERS)
ACCESS(Boolean, int, booleans, BOOLEANS)
STUB(fmi2GetString)
STUB(fmi2SetString)

EXPORT int fmi2GetFMUstate(Body *b, Body **state) {
    if (!*state) *state = malloc(sizeof **state);
    return **state = *b, OK;
}
EXPORT int fmi2SetFMUstate(Body *b, const Body *state) { return *b = *state, OK; }
EXPORT int fmi2FreeFMUstate(Body *b, Body **state) {
    (void)b;
    free(*state);
    return *state = NULL, OK;
}

EXPORT int fmi2GetDirectionalDerivative(Body *b, References unknowns, size_t n, References knowns, size_t count,
                                        const double *seed, double *result) {
    const double *r = b->reals;
    for (size_t i = 0; i < n; i++) {
        result[i] = 0;
        for (size_t j = 0; j < count; j++) {
            if (unknowns[i] == FORCE && knowns[j] == P) result[i] -= r[C] * seed[j];
            if (unknowns[i] == Y && knowns[j] == U) result[i] += (r[GAIN] + 2 * r[CURVE] * r[U]) * seed[j];
        }
    }
    return OK;
}

/* --- model exchange -------------------------------------------------------------------------------- */

EXPORT int fmi2SetTime(Body *b, double time) { return b->reals[TIME] = time, OK; }
EXPORT int fmi2SetContinuousStates(Body *b, const double *states, size_t n) {
    return memcpy(b->reals + X, states, n * sizeof *states), OK;
}
EXPORT int fmi2GetContinuousStates(Body *b, double *states, size_t n) {
    return memcpy(states, b->reals + X, n * sizeof *states), OK;
}
EXPORT int fmi2GetDerivatives(Body *b, double *derivatives, size_t n) {
    evaluate(b);
    return memcpy(derivatives, b->reals + DER_X, n * sizeof *derivatives), OK;
}
EXPORT int fmi2GetEventIndicators(Body *b) { return (void)b, OK; }
EXPORT int fmi2GetNominalsOfContinuousStates(Body *b, double *nominals, size_t n) {
    (void)b;
    for (size_t i = 0; i < n; i++) nominals[i] = 1;
    return OK;
}
EXPORT int fmi2EnterEventMode(Body *b) { return (void)b, OK; }
EXPORT int fmi2EnterContinuousTimeMode(Body *b) { return (void)b, OK; }
EXPORT int fmi2NewDiscreteStates(Body *b, Event *info) {
    (void)b;
    memset(info, 0, sizeof *info);
    return OK;
}
EXPORT int fmi2CompletedIntegratorStep(Body *b, int no_earlier, int *event, int *end) {
    (void)b, (void)no_earlier;
    return *event = *end = 0, OK;
}

STUB(fmi2SerializedFMUstateSize)
STUB(fmi2SerializeFMUstate)
STUB(fmi2DeSerializeFMUstate)
STUB(fmi2SetRealInputDerivatives)
STUB(fmi2GetRealOutputDerivatives)
STUB(fmi2CancelStep)
STUB(fmi2GetStatus)
STUB(fmi2GetRealStatus)
STUB(fmi2GetIntegerStatus)
STUB(fmi2GetBooleanStatus)
STUB(fmi2GetStringStatus)
