/* An FMU for model exchange and co-simulation that accepts only what FMI 2.0.5 allows, and behaves in ways that hosts
 * must expect:
 *
 *     x' = -RATE (x - cos t)      y = x + F(u)      level = x at the last event      on = whether an event was handled
 *
 * Empty calls are refused. In initialization mode, only outputs, x and x' are read, which computes `on`. In
 * co-simulation, nothing is read between set and step, and no step goes beyond the stop time. Steps end in an event at
 * each multiple of 0.1 s. In co-simulation, the implicit Euler method is used.
 *
 * -DSTIFF has a large rate, -DKINK has F(u) = |u|, with its slope from the left, -DJUMP has F(u) = (u > 0),
 * -DDIFFERENCES has derivatives that are 2.5 % off, -DENDS=t ends the run at t, where `level` is -1, -DASSERTS refuses to evaluate u > 0.04,
 * -DNOISE=x adds a number of this size to `level`, which changes with each evaluation, -DSLOW=t takes that long for
 * each step, and ten times as long for the first one after a state was restored, and -DRESTARTS has a solver that starts anew when a state is restored, and whose steps depend on the
 * rounding of times, with an error of 1e-5 each. -DLENIENT accepts what hosts must not do.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "stubs.h"

enum { TIME, U, X, DER_X, Y, LEVEL, ON = 10 };
enum Phase { NEW, INITIALIZING, EVENT, CONTINUOUS, STEPPED, ENDED };

#ifdef STIFF
#define RATE 1e5
#else
#define RATE 1.0
#endif
#ifdef KINK
#define F(u) fabs(u)
#elif defined JUMP
#define F(u) ((u) > 0)
#elif defined DIFFERENCES
#define F(u) exp(u)
#else
#define F(u) (2 * (u))
#endif
#ifndef ENDS
#define ENDS HUGE_VAL
#endif
#ifndef NOISE
#define NOISE 0
#endif
#ifndef SLOW
#define SLOW 0
#endif
#ifdef LENIENT
#define EMPTY OK
#else
#define EMPTY ERROR
#endif
#define PERIOD 0.1

typedef struct {
    double time, stop, x, u, level;
    int on, events, is_exchange, is_set, evaluations, is_restored;
    enum Phase phase;
} Lawful;

EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORT const char *fmi2GetVersion(void) { return "2.0"; }
EXPORT int fmi2SetDebugLogging(void) { return OK; }

EXPORT int fmi2Reset(Lawful *c) {
    *c = (Lawful){.stop = HUGE_VAL, .x = 1, .level = 1, .is_exchange = c->is_exchange};
    return OK;
}

EXPORT Lawful *fmi2Instantiate(const char *name, int kind, const char *guid) {
    if (!name || strcmp(guid, "{lawful}")) return NULL;
    Lawful *c = calloc(1, sizeof *c);
    c->is_exchange = kind == MODEL_EXCHANGE;
    fmi2Reset(c);
    return c;
}

EXPORT void fmi2FreeInstance(Lawful *c) { free(c); }

EXPORT int fmi2SetupExperiment(Lawful *c, int has_tolerance, double tolerance, double start, int has_stop,
                               double stop) {
    (void)has_tolerance, (void)tolerance;
    if (c->phase != NEW) return ERROR;
    c->time = start;
    if (has_stop) c->stop = stop;
    return OK;
}

EXPORT int fmi2EnterInitializationMode(Lawful *c) {
    if (c->phase != NEW) return ERROR;
    return c->phase = INITIALIZING, OK;
}

EXPORT int fmi2ExitInitializationMode(Lawful *c) {
    if (c->phase != INITIALIZING) return ERROR;
    c->on = 1;
    c->events = (int)(c->time / PERIOD + 1e-9);
    c->phase = c->is_exchange ? EVENT : STEPPED;
    return OK;
}

EXPORT int fmi2Terminate(Lawful *c) {
    if (c->phase < EVENT) return ERROR;
    return c->phase = ENDED, OK;
}

static double slope(const Lawful *c) { return -RATE * (c->x - cos(c->time)); }

static void handle_event(Lawful *c) {
    c->events++;
    c->level = c->x;
}

/* Whether a variable may be read now. */
static int is_readable(const Lawful *c, unsigned reference) {
#ifdef LENIENT
    return c->phase != NEW;
#endif
    if (c->phase == INITIALIZING) return reference == X || reference == DER_X || reference == Y || reference == LEVEL;
    return c->phase != NEW && !c->is_set;
}

EXPORT int fmi2GetReal(Lawful *c, References r, size_t n, double *values) {
    if (!n) return EMPTY;
    for (size_t i = 0; i < n; i++) {
        if (!is_readable(c, r[i])) return ERROR;
#ifdef ASSERTS
        if (c->u > 0.04) return ERROR;
#endif
        c->on = 1;
        switch (r[i]) {
        case TIME: values[i] = c->time; break;
        case U: values[i] = c->u; break;
        case X: values[i] = c->x; break;
        case DER_X: values[i] = slope(c); break;
        case Y: values[i] = c->x + F(c->u); break;
        case LEVEL: values[i] = c->level + NOISE * (c->evaluations % 3); break;
        default: return ERROR;
        }
    }
    return OK;
}

EXPORT int fmi2SetReal(Lawful *c, References r, size_t n, const double *values) {
    if (!n) return EMPTY;
    if (n != 1 || !(r[0] == U || (r[0] == X && c->phase < EVENT)) || c->phase == ENDED) return ERROR;
    *(r[0] == U ? &c->u : &c->x) = *values;
    c->evaluations++;
    c->is_set = c->phase == STEPPED;
    return isfinite(*values) ? OK : ERROR;
}

EXPORT int fmi2GetBoolean(Lawful *c, References r, size_t n, int *values) {
    if (n != 1 || r[0] != ON || !is_readable(c, r[0])) return ERROR;
    return *values = c->on, OK;
}

EXPORT int fmi2DoStep(Lawful *c, double time, double step, int no_set_state) {
    (void)no_set_state;
    const double end = time + step;
    if (c->phase != STEPPED || !(fabs(time - c->time) <= 1e-9) || !(step > 0) || end > c->stop + 1e-9) return ERROR;
    usleep((unsigned)(SLOW * (c->is_restored ? 1e7 : 1e6)));
    c->is_set = 0;
    if (end > ENDS) return c->phase = ENDED, c->level = -1, DISCARD;
#ifdef RESTARTS
    c->x += c->is_restored * 1e-5;
    const int parts = (int)ceil(step / 1e-3);
#else
    const int parts = (int)ceil(step / 1e-3 - 1e-6);
#endif
    c->is_restored = 0;
    for (int k = 1; k <= parts; k++) {
        const double h = step / parts;
        c->time = time + k * h;
        c->x = (c->x + h * RATE * cos(c->time)) / (1 + h * RATE);
    }
    c->time = end;
    if (c->time > (c->events + 1) * PERIOD - 1e-9) handle_event(c);
    return OK;
}

EXPORT int fmi2GetBooleanStatus(Lawful *c, int kind, int *value) {
    if (kind != TERMINATED) return ERROR;
    return *value = c->phase == ENDED, OK;
}

EXPORT int fmi2GetDirectionalDerivative(Lawful *c, References of, size_t n, References by, size_t m, const double *seed,
                                        double *values) {
    if (!n || !m || c->phase == NEW) return ERROR;
    for (size_t i = 0; i < n; i++) {
        values[i] = 0;
        for (size_t k = 0; k < m; k++) {
            double derivative = 0;
            if (by[k] == X) derivative = of[i] == Y ? 1 : of[i] == DER_X ? -RATE : 0;
#ifdef KINK
            if (by[k] == U && of[i] == Y) derivative = c->u > 0 ? 1 : -1;
#elif defined JUMP
            (void)c;
#else
            const double h = 0.05;
            if (by[k] == U && of[i] == Y) derivative = (F(c->u + h * seed[k]) - F(c->u)) / h / seed[k];
#endif
            values[i] += derivative * seed[k];
        }
    }
    return OK;
}

EXPORT int fmi2GetRealOutputDerivatives(Lawful *c, References r, size_t n, const int *orders, double *values) {
    if (n != 1 || r[0] != Y || orders[0] != 1) return ERROR;
    return *values = slope(c), OK;
}

EXPORT int fmi2GetFMUstate(Lawful *c, Lawful **state) {
    if (!*state) *state = malloc(sizeof *c);
    return **state = *c, OK;
}

EXPORT int fmi2SetFMUstate(Lawful *c, const Lawful *state) {
    *c = *state;
    c->is_restored = 1;
    return OK;
}

EXPORT int fmi2FreeFMUstate(Lawful *c, Lawful **state) {
    (void)c;
    free(*state);
    return *state = NULL, OK;
}

/* Model exchange. */
EXPORT int fmi2EnterEventMode(Lawful *c) {
    if (c->phase != CONTINUOUS) return ERROR;
    return c->phase = EVENT, OK;
}

EXPORT int fmi2NewDiscreteStates(Lawful *c, Event *event) {
    if (c->phase != EVENT) return ERROR;
    if (c->time >= (c->events + 1) * PERIOD - 1e-9) handle_event(c);
    if (c->time >= ENDS) c->level = -1;
    *event = (Event){.terminate = c->time >= ENDS, .next_event_time_defined = 1, .next_event_time = (c->events + 1) * PERIOD};
    return OK;
}

EXPORT int fmi2EnterContinuousTimeMode(Lawful *c) {
    if (c->phase != EVENT) return ERROR;
    return c->phase = CONTINUOUS, OK;
}

EXPORT int fmi2CompletedIntegratorStep(Lawful *c, int no_set_state, int *event, int *terminate) {
    (void)no_set_state;
    *event = 0, *terminate = c->time >= ENDS;
    return c->phase == CONTINUOUS ? OK : ERROR;
}

EXPORT int fmi2SetTime(Lawful *c, double time) { return c->time = time, OK; }

EXPORT int fmi2SetContinuousStates(Lawful *c, const double *states, size_t n) {
    if (n != 1 || c->phase != CONTINUOUS) return ERROR;
    return c->x = states[0], OK;
}

EXPORT int fmi2GetContinuousStates(Lawful *c, double *states, size_t n) {
    if (n != 1 || c->phase == NEW) return ERROR;
    return states[0] = c->x, OK;
}

EXPORT int fmi2GetDerivatives(Lawful *c, double *derivatives, size_t n) {
    if (n != 1 || c->phase == NEW) return ERROR;
    return derivatives[0] = slope(c), OK;
}

EXPORT int fmi2GetNominalsOfContinuousStates(Lawful *c, double *nominals, size_t n) {
    if (n != 1 || c->phase == NEW) return ERROR;
    return nominals[0] = 1, OK;
}

STUB(fmi2GetInteger)
STUB(fmi2GetString)
STUB(fmi2SetInteger)
STUB(fmi2SetBoolean)
STUB(fmi2SetString)
STUB(fmi2SerializedFMUstateSize)
STUB(fmi2SerializeFMUstate)
STUB(fmi2DeSerializeFMUstate)
STUB(fmi2SetRealInputDerivatives)
STUB(fmi2CancelStep)
STUB(fmi2GetStatus)
STUB(fmi2GetRealStatus)
STUB(fmi2GetIntegerStatus)
STUB(fmi2GetStringStatus)
STUB(fmi2GetEventIndicators)
