/* A tank with a valve, an FMU of FMI 3.0 for model exchange without directional derivatives: x' = u - sqrt(x), y = x + u^2.
   A level x below 0, and values of u outside LOW and HIGH, are refused. */
#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

enum { OK, ERROR = 3 };
enum { TIME, X, U, Y, DER };

#ifndef LOW
#define LOW 0
#endif
#ifndef HIGH
#define HIGH 1
#endif

typedef struct {
    double values[DER];
} Valve;

typedef const unsigned *References;

void *fmi3InstantiateModelExchange(const char *name, const char *token) {
    return name && !strcmp(token, "{valve}") ? calloc(1, sizeof(Valve)) : NULL;
}

void fmi3FreeInstance(Valve *c) { free(c); }

int fmi3EnterInitializationMode(Valve *c) { return (void)c, OK; }

int fmi3ExitInitializationMode(Valve *c) { return (void)c, OK; }

int fmi3Terminate(Valve *c) { return (void)c, OK; }

int fmi3EnterEventMode(Valve *c) { return (void)c, OK; }

int fmi3EnterContinuousTimeMode(Valve *c) { return (void)c, OK; }

int fmi3SetTime(Valve *c, double time) { return c->values[TIME] = time, OK; }

int fmi3GetNumberOfContinuousStates(Valve *c, size_t *n) { return (void)c, *n = 1, OK; }

int fmi3GetNumberOfEventIndicators(Valve *c, size_t *n) { return (void)c, *n = 0, OK; }

int fmi3GetContinuousStates(Valve *c, double *states, size_t n) { return *states = c->values[X], n == 1 ? OK : ERROR; }

int fmi3GetNominalsOfContinuousStates(Valve *c, double *nominals, size_t n) {
    return (void)c, *nominals = 1, n == 1 ? OK : ERROR;
}

int fmi3CompletedIntegratorStep(Valve *c, bool no_set_state, bool *event, bool *terminate) {
    (void)c, (void)no_set_state;
    return *event = *terminate = false, OK;
}

int fmi3UpdateDiscreteStates(Valve *c, bool *again, bool *terminate, bool *nominals, bool *states, bool *has_next) {
    (void)c;
    return *again = *terminate = *nominals = *states = *has_next = false, OK;
}

static int set(Valve *c, unsigned r, double value) {
    if ((r == X && value < 0) || (r == U && (value < LOW || value > HIGH)) || (r != X && r != U)) return ERROR;
    return c->values[r] = value, OK;
}

int fmi3SetContinuousStates(Valve *c, const double *states, size_t n) { return n == 1 ? set(c, X, *states) : ERROR; }

int fmi3GetContinuousStateDerivatives(Valve *c, double *derivatives, size_t n) {
    return *derivatives = c->values[U] - sqrt(c->values[X]), n == 1 ? OK : ERROR;
}

int fmi3SetFloat64(Valve *c, References r, size_t n, const double *values, size_t count) {
    for (size_t k = 0; k < count; k++) {
        if (n != count || set(c, r[k], values[k]) != OK) return ERROR;
    }
    return OK;
}

int fmi3GetFloat64(Valve *c, References r, size_t n, double *values, size_t count) {
    for (size_t k = 0; k < count; k++) {
        if (n != count || r[k] > DER) return ERROR;
        const double x = c->values[X], u = c->values[U];
        values[k] = r[k] == Y ? x + u * u : r[k] == DER ? u - sqrt(x) : c->values[r[k]];
    }
    return OK;
}
