/* An FMU for model exchange and co-simulation whose mode depends on its inputs, with samples at two rates:
 *
 *     high = u above limit, until u is below limit - 0.2          level' = high - level / 2
 *     gear = wanted, gate = open, at events                       volume' = gear if gate, else 0
 *     fast = samples every 0.01 s                                 slow = fast, sampled every 0.1 s after it
 *     ripple = sin 1000 t
 *
 * Co-simulation takes Euler steps. A defect or another solver is chosen by its name: cc -DMISSES_INDICATOR ...
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "stubs.h"

enum { TIME, U, LIMIT, LEVEL, DER_LEVEL, VOLUME, DER_VOLUME, RIPPLE, REALS };
enum { WANTED, GEAR, FAST, SLOW, INTEGERS };
enum { OPEN, GATE, HIGH, BOOLEANS };

#ifdef ONE_EULER_STEP
#define LONGEST 1e3
#else
#define LONGEST 1e-3 /* Euler step [s] */
#endif
#define ROUNDING 1e-9 /* of times [s] */

typedef struct {
    double reals[REALS];
    double start;
    /* The input that the relay sees. */
    double seen;
    int integers[INTEGERS], booleans[BOOLEANS];
    int fast_samples, slow_samples, was_positive;
} Hybrid;

EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORT const char *fmi2GetVersion(void) { return "2.0"; }
EXPORT int fmi2SetDebugLogging(void) { return OK; }

EXPORT int fmi2Reset(Hybrid *h) {
    memset(h, 0, sizeof *h);
    h->reals[LIMIT] = 0.5;
    h->integers[WANTED] = h->integers[GEAR] = 1;
    return OK;
}

EXPORT Hybrid *fmi2Instantiate(const char *name, int kind, const char *guid) {
    (void)kind;
    if (!name || strcmp(guid, "{hybrid}")) return NULL;
    Hybrid *h = malloc(sizeof *h);
    fmi2Reset(h);
    return h;
}

EXPORT void fmi2FreeInstance(Hybrid *h) { free(h); }

EXPORT int fmi2SetupExperiment(Hybrid *h, int has_tolerance, double tolerance, double start) {
    (void)has_tolerance, (void)tolerance;
    return h->reals[TIME] = h->start = start, OK;
}

/* --- the equations -------------------------------------------------------------------------------- */

static void see(Hybrid *h) {
    h->seen = h->reals[U];
#ifdef CHATTERS
    h->seen += h->reals[VOLUME];
#endif
}

static double indicator(const Hybrid *h) {
    double limit = h->reals[LIMIT];
#ifndef CHATTERS
    if (h->booleans[HIGH]) limit -= 0.2;
#endif
    return h->seen - limit;
}

static void derive(Hybrid *h) {
    double *r = h->reals;
    r[DER_LEVEL] = h->booleans[HIGH] - r[LEVEL] / 2;
    r[DER_VOLUME] = h->booleans[GATE] ? h->integers[GEAR] : 0;
#ifdef CHATTERS
    r[DER_VOLUME] = h->booleans[HIGH] ? -1 : 1;
#endif
    r[RIPPLE] = sin(1e3 * r[TIME]);
}

static double next_fast(const Hybrid *h) { return h->start + (h->fast_samples + 1) * 0.01; }
static double next_slow(const Hybrid *h) { return h->start + (h->slow_samples + 1) * 0.1; }
static double next_sample(const Hybrid *h) { return fmin(next_fast(h), next_slow(h)); }

static void sample_slow(Hybrid *h, double end) {
    for (; next_slow(h) <= end + ROUNDING; h->slow_samples++) h->integers[SLOW] = h->integers[FAST];
}

/* Takes the samples that are due. */
static void sample(Hybrid *h) {
    if (next_fast(h) <= h->reals[TIME] + ROUNDING) h->fast_samples++, h->integers[FAST]++;
    sample_slow(h, h->reals[TIME]);
}

/* Handles an event of the mode. */
static void handle(Hybrid *h) {
    h->booleans[HIGH] = indicator(h) > 0;
    h->booleans[GATE] = h->booleans[OPEN];
    h->integers[GEAR] = h->integers[WANTED];
    h->was_positive = indicator(h) > 0;
    derive(h);
}

EXPORT int fmi2EnterInitializationMode(Hybrid *h) { return see(h), derive(h), OK; }
EXPORT int fmi2ExitInitializationMode(Hybrid *h) { return see(h), handle(h), OK; }
EXPORT int fmi2Terminate(Hybrid *h) { return (void)h, OK; }

/* --- co-simulation -------------------------------------------------------------------------------- */

static void move(Hybrid *h, double end) {
    const double step = end - h->reals[TIME];
    derive(h);
    h->reals[LEVEL] += step * h->reals[DER_LEVEL];
    h->reals[VOLUME] += step * h->reals[DER_VOLUME];
    h->reals[TIME] = end;
#ifdef CHATTERS
    see(h);
#endif
    if ((indicator(h) > 0) != h->was_positive) handle(h);
    sample(h);
}

EXPORT int fmi2DoStep(Hybrid *h, double time, double step) {
    if (!(step >= 0 && step < 1e3) || fabs(time - h->reals[TIME]) > 1e-6) return ERROR;
#ifdef SLOW_FIRST
    sample_slow(h, time + step);
#endif
#ifndef LATE
    see(h);
#endif
#ifdef MISSES_INDICATOR
    h->was_positive = indicator(h) > 0;
#endif
    int is_event = (indicator(h) > 0) != h->was_positive;
#ifndef MISSES_DISCRETE
    is_event |= h->booleans[GATE] != h->booleans[OPEN] || h->integers[GEAR] != h->integers[WANTED];
#endif
    if (is_event) handle(h);
    const double end = time + step;
    while (h->reals[TIME] < end - ROUNDING)
        move(h, fmin(fmin(h->reals[TIME] + LONGEST, next_sample(h)), end));
    h->reals[TIME] = end;
    see(h);
    derive(h);
    return OK;
}

/* --- model exchange ------------------------------------------------------------------------------- */

EXPORT int fmi2EnterEventMode(Hybrid *h) { return (void)h, OK; }
EXPORT int fmi2EnterContinuousTimeMode(Hybrid *h) { return (void)h, OK; }

EXPORT int fmi2NewDiscreteStates(Hybrid *h, Event *event) {
    see(h);
    handle(h);
    sample(h);
    *event = (Event){.next_event_time_defined = 1, .next_event_time = next_sample(h)};
    return OK;
}

EXPORT int fmi2CompletedIntegratorStep(Hybrid *h, int no_set_state, int *event, int *terminate) {
    (void)h, (void)no_set_state;
    return *event = *terminate = 0, OK;
}

EXPORT int fmi2SetTime(Hybrid *h, double time) { return h->reals[TIME] = time, derive(h), OK; }

EXPORT int fmi2SetContinuousStates(Hybrid *h, const double *states, size_t n) {
    if (n != 2) return ERROR;
    return h->reals[LEVEL] = states[0], h->reals[VOLUME] = states[1], derive(h), OK;
}

EXPORT int fmi2GetContinuousStates(Hybrid *h, double *states, size_t n) {
    return n == 2 ? (states[0] = h->reals[LEVEL], states[1] = h->reals[VOLUME], OK) : ERROR;
}

EXPORT int fmi2GetDerivatives(Hybrid *h, double *rates, size_t n) {
    return n == 2 ? (rates[0] = h->reals[DER_LEVEL], rates[1] = h->reals[DER_VOLUME], OK) : ERROR;
}

EXPORT int fmi2GetEventIndicators(Hybrid *h, double *indicators, size_t n) {
    return n == 1 ? (see(h), *indicators = indicator(h), OK) : ERROR;
}

EXPORT int fmi2GetNominalsOfContinuousStates(Hybrid *h, double *nominals, size_t n) {
    return h && n == 2 ? (nominals[0] = nominals[1] = 1, OK) : ERROR;
}

/* --- get and set ---------------------------------------------------------------------------------- */

#define ACCESS(type, value, values_of, count, is_settable)                                         \
    EXPORT int fmi2Get##type(Hybrid *h, References r, size_t n, value *values) {                   \
        for (size_t i = 0; i < n; i++) {                                                           \
            if (r[i] >= count) return ERROR;                                                       \
            values[i] = h->values_of[r[i]];                                                        \
        }                                                                                          \
        return OK;                                                                                 \
    }                                                                                              \
    EXPORT int fmi2Set##type(Hybrid *h, References r, size_t n, const value *values) {             \
        for (size_t i = 0; i < n; i++) {                                                           \
            if (!(is_settable)) return ERROR;                                                      \
            h->values_of[r[i]] = values[i];                                                        \
        }                                                                                          \
        return OK;                                                                                 \
    }

#ifdef REFUSES
#define MOST 0.4
#else
#define MOST 1e6
#endif
ACCESS(Real, double, reals, REALS, (r[i] == U || r[i] == LIMIT) && fabs(values[i]) <= MOST)
ACCESS(Integer, int, integers, INTEGERS, r[i] == WANTED)
ACCESS(Boolean, int, booleans, BOOLEANS, r[i] == OPEN)
STUB(fmi2GetString)
STUB(fmi2SetString)
OPTIONAL_STUBS
