/* A small FMU for co-simulation with its own solver: x' = u - x^3, y = x.
 *
 * The solver (Heun with Euler, adaptive steps) keeps the local error within the tolerance given in
 * fmi2SetupExperiment, 1e-4 by default. The outputs `tolerance` and `stop` show what was given there,
 * 0 if nothing was.
 */
#include <math.h>
#include <stdlib.h>

#include "stubs.h"

enum { X, U, Y, TOLERANCE, STOP, REALS };

typedef struct {
    double reals[REALS];
    double step;
} Instance;

EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORT const char *fmi2GetVersion(void) { return "2.0"; }
EXPORT int fmi2SetDebugLogging(void) { return OK; }

EXPORT int fmi2Reset(Instance *c) {
    *c = (Instance){.reals = {[X] = 1, [Y] = 1}, .step = 0.01};
    return OK;
}

EXPORT Instance *fmi2Instantiate(void) {
    Instance *c = malloc(sizeof *c);
    fmi2Reset(c);
    return c;
}

EXPORT void fmi2FreeInstance(Instance *c) { free(c); }

EXPORT int fmi2SetupExperiment(Instance *c, int tolerance_defined, double tolerance, double start,
                               int stop_defined, double stop) {
    (void)start;
    c->reals[TOLERANCE] = tolerance_defined ? tolerance : 0;
    c->reals[STOP] = stop_defined ? stop : 0;
    return OK;
}

EXPORT int fmi2EnterInitializationMode(Instance *c) {
    c->reals[Y] = c->reals[X];
    return OK;
}

EXPORT int fmi2ExitInitializationMode(Instance *c) {
    (void)c;
#ifdef FAIL_INITIALIZATION
    return ERROR;
#else
    return OK;
#endif
}

EXPORT int fmi2Terminate(Instance *c) { return c ? OK : ERROR; }

static double derivative(const Instance *c, double x) { return c->reals[U] - x * x * x; }

EXPORT int fmi2DoStep(Instance *c, double time, double step) {
    double *r = c->reals, tolerance = r[TOLERANCE] > 0 ? r[TOLERANCE] : 1e-4;
    if (r[STOP] > 0 && time + step > r[STOP] * (1 + 1e-9)) return ERROR;
    for (double done = 0; done < step;) {
        double h = fmin(c->step, step - done), a = derivative(c, r[X]);
        double b = derivative(c, r[X] + h * a), error = fabs(h * (b - a) / 2);
        if (error <= tolerance) {
            r[X] += h * (a + b) / 2;
            done += h;
        }
        c->step = h * fmin(2, 0.9 * sqrt(tolerance / fmax(error, 1e-300)));
    }
    r[Y] = r[X];
    return OK;
}

EXPORT int fmi2GetReal(Instance *c, References references, size_t n, double *values) {
    for (size_t i = 0; i < n; i++) {
        if (references[i] >= REALS) return ERROR;
        values[i] = c->reals[references[i]];
    }
    return OK;
}

EXPORT int fmi2SetReal(Instance *c, References references, size_t n, const double *values) {
    for (size_t i = 0; i < n; i++) {
        if (references[i] > U) return ERROR;
        c->reals[references[i]] = values[i];
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
