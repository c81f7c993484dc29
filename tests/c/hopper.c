/* A ball on a floor that is kicked, an FMU of FMI 3.0 for model exchange:
 *
 *     h' = v       v' = a[1] + 2 a[2] in flight, 0 on the floor, from which it rises where this is positive
 *     z' = w       w' = -OMEGA^2 z
 *
 * Each event takes the input n. A new value is a kick: v grows by n/1000, and z starts again from SMALL, with this
 * nominal value. A ball that falls to the floor lands, which `landings` counts; ON_LANDING may do more. Each
 * event gives its own time as the next event time, which importers must ignore. Functions that change discrete states
 * or inputs are refused outside event mode.
 */
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum { OK, ERROR = 3 };
enum { TIME, H, V, Z, W, A, N = 10, LANDINGS };

#define OMEGA 10
#define SMALL 1e-9

typedef struct {
    double time, states[4], a[2], nominal;
    int n, taken, landings;
    bool flies, in_event_mode;
} Hopper;

typedef const unsigned *References;

static double acceleration(const Hopper *c) { return c->a[0] + 2 * c->a[1]; }

void *fmi3InstantiateModelExchange(const char *name, const char *token) {
    if (!name || strcmp(token, "{hopper}")) return NULL;
    Hopper *c = calloc(1, sizeof *c);
    c->a[0] = -9.81;
    c->states[Z - H] = c->nominal = 1;
    c->in_event_mode = true;
    return c;
}

void fmi3FreeInstance(Hopper *c) { free(c); }

int fmi3EnterInitializationMode(Hopper *c, bool has_tolerance, double tolerance, double start) {
    (void)has_tolerance, (void)tolerance;
    c->time = start;
    return OK;
}

int fmi3ExitInitializationMode(Hopper *c) { return (void)c, OK; }

int fmi3Terminate(Hopper *c) { return (void)c, OK; }

int fmi3EnterEventMode(Hopper *c) { return c->in_event_mode = true, OK; }

int fmi3EnterContinuousTimeMode(Hopper *c) { return c->in_event_mode = false, OK; }

int fmi3SetTime(Hopper *c, double time) { return c->time = time, OK; }

int fmi3GetNumberOfContinuousStates(Hopper *c, size_t *n) { return (void)c, *n = 4, OK; }

int fmi3GetNumberOfEventIndicators(Hopper *c, size_t *n) { return (void)c, *n = 1, OK; }

int fmi3GetContinuousStates(Hopper *c, double *states, size_t n) {
    memcpy(states, c->states, n * sizeof *states);
    return OK;
}

int fmi3SetContinuousStates(Hopper *c, const double *states, size_t n) {
    memcpy(c->states, states, n * sizeof *states);
    return c->in_event_mode ? ERROR : OK;
}

int fmi3GetContinuousStateDerivatives(Hopper *c, double *derivatives, size_t n) {
    const double *s = c->states;
#ifdef ON_DERIVATIVES
    ON_DERIVATIVES;
#endif
    const double all[] = {s[V - H], c->flies ? acceleration(c) : 0, s[W - H], -OMEGA * OMEGA * s[Z - H]};
    memcpy(derivatives, all, n * sizeof *derivatives);
    return OK;
}

int fmi3GetEventIndicators(Hopper *c, double *indicators, size_t n) {
    if (n) *indicators = c->flies ? c->states[0] : acceleration(c);
    return OK;
}

int fmi3GetNominalsOfContinuousStates(Hopper *c, double *nominals, size_t n) {
    for (size_t i = 0; i < n; i++) nominals[i] = i < 2 ? 1 : c->nominal;
    return OK;
}

int fmi3CompletedIntegratorStep(Hopper *c, bool no_set_state, bool *event, bool *terminate) {
    (void)c, (void)no_set_state;
    *event = *terminate = false;
    return OK;
}

int fmi3UpdateDiscreteStates(Hopper *c, bool *again, bool *terminate, bool *nominals, bool *states, bool *has_next,
                             double *next) {
    double *s = c->states;
    *again = *terminate = *nominals = *states = false;
    *has_next = true;
    *next = c->time;
    if (!c->in_event_mode) return ERROR;
#ifdef ON_EVENT
    ON_EVENT;
#endif
    if (c->n != c->taken) {
        c->taken = c->n;
        c->flies = *again = *nominals = *states = true;
        s[V - H] += c->n / 1000.0;
        s[Z - H] = c->nominal = SMALL;
        s[W - H] = 0;
    } else if (c->flies && s[0] <= 0 && s[V - H] < 0) {
        c->flies = false;
        c->landings++;
#ifdef ON_LANDING
        ON_LANDING;
#endif
        *states = true;
        s[0] = s[V - H] = 0;
    } else if (acceleration(c) > 0) {
        c->flies = true;
    }
    return OK;
}

int fmi3SetFloat64(Hopper *c, References r, size_t n, const double *values, size_t count) {
    if (n != 1 || r[0] != A || count != 2) return ERROR;
    memcpy(c->a, values, sizeof c->a);
    return OK;
}

int fmi3SetInt32(Hopper *c, References r, size_t n, const int32_t *values, size_t count) {
    if (n != 1 || r[0] != N || count != 1) return ERROR;
    c->n = *values;
    return c->in_event_mode ? OK : ERROR;
}

int fmi3GetFloat64(Hopper *c, References r, size_t n, double *values, size_t count) {
    if (n != count) return ERROR;
    for (size_t i = 0; i < n; i++) {
        if (r[i] > W) return ERROR;
        values[i] = r[i] == TIME ? c->time : c->states[r[i] - H];
    }
    return OK;
}

int fmi3GetInt32(Hopper *c, References r, size_t n, int32_t *values, size_t count) {
    if (n != 1 || r[0] != LANDINGS || count != 1) return ERROR;
    return *values = c->landings, OK;
}
