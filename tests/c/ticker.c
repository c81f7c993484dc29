/* A co-simulation FMU of FMI 3.0 with clocks of all kinds. It is strict: it returns an error to a host that violates the
 * standard, or ticks a time-based clock at another time than it should.
 *
 *     sample    ticks at `shift` + k `interval`, or at k (k + 1) / 2 `interval` if it is a changing clock
 *     received  is triggered, with the message
 *     alarm     ticks `delay` s after received, unless that is negative (countdown)
 *     sent      ticks with sample and alarm, with received if `echo` is set, and at multiples of `period`, where a step
 *               returns early; then value = message + 1
 *
 * Its outputs count the ticks, and have the times of the last ones. A defect is chosen by its name: cc -DNEVER_KNOWN ...
 */
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum { SAMPLE = 1, RECEIVED, ALARM, SENT, CLOCKS };
enum { MESSAGE = 10, VALUE, SEEN, SAMPLED_AT, RECEIVED_AT, ALARMED_AT, INTERVAL, SHIFT, DELAY, PERIOD, U, SUM, REALS };
enum { SAMPLES = 30, RECEIPTS, ALARMS, SENTS, UPDATES, FOLLOWED, LEVEL, STEPS, INTEGERS };
enum { ECHO = 40 };
enum { INSTANTIATED, INITIALIZATION, STEP, EVENT };

typedef struct {
    double reals[REALS], time, start, due[CLOCKS];
    int32_t integers[INTEGERS];
    bool active[CLOCKS], echo, is_computed, is_new;
    double told;
    int state, crossings;
} Ticker;

typedef const unsigned int *References;

#define CHECK(condition)                                                                           \
    if (!(condition)) return 3

void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible,
                                  bool logging, bool events, bool early, References intermediate, size_t n,
                                  void *environment, void *log, void *update) {
    (void)name, (void)resources, (void)visible, (void)logging, (void)intermediate, (void)n;
    (void)environment, (void)log, (void)update;
    if (strcmp(token, "{ticker}") || !events || !early) return NULL;
    Ticker *t = calloc(1, sizeof *t);
    t->reals[INTERVAL] = 0.25;
    t->reals[DELAY] = t->reals[PERIOD] = -1;
    return t;
}

void fmi3FreeInstance(void *instance) { free(instance); }

int fmi3EnterInitializationMode(Ticker *t, bool has_tolerance, double tolerance, double start) {
    (void)has_tolerance, (void)tolerance;
    CHECK(t->state == INSTANTIATED);
    t->time = t->start = start;
    t->state = INITIALIZATION;
    t->due[SAMPLE] = start + t->reals[SHIFT];
    t->due[ALARM] = -1;
#ifdef CHANGING
    t->due[SAMPLE] = start + t->reals[INTERVAL];
#endif
#ifdef SILENT
    t->due[SAMPLE] = INFINITY;
#endif
    return 0;
}

int fmi3ExitInitializationMode(Ticker *t) { return t->state = EVENT, 0; }
int fmi3Terminate(Ticker *t) { return (void)t, 0; }

int fmi3EnterEventMode(Ticker *t) {
    CHECK(t->state == STEP);
    t->is_computed = false;
    return t->state = EVENT, 0;
}

int fmi3EnterStepMode(Ticker *t) {
    CHECK(t->state == EVENT && !t->active[SAMPLE] && !t->active[RECEIVED] && !t->active[ALARM]);
    return t->state = STEP, 0;
}

static double crossing(const Ticker *t) {
    return t->reals[PERIOD] > 0 ? t->start + (t->crossings + 1) * t->reals[PERIOD] : INFINITY;
}

/* Does what the ticks of this super-dense instant are to do, once. */
static void compute(Ticker *t) {
    if (t->is_computed) return;
    t->is_computed = true;
    const int counters[] = {[SAMPLE] = SAMPLES, [RECEIVED] = RECEIPTS, [ALARM] = ALARMS};
    const int times[] = {[SAMPLE] = SAMPLED_AT, [RECEIVED] = RECEIVED_AT, [ALARM] = ALARMED_AT};
    for (int clock = SAMPLE; clock <= ALARM; clock++)
        if (t->active[clock]) t->integers[counters[clock]]++, t->reals[times[clock]] = t->time;
    if (t->active[RECEIVED]) t->reals[SEEN] = t->reals[MESSAGE];
    if (t->active[RECEIVED] && t->reals[DELAY] >= 0) t->due[ALARM] = t->time + t->reals[DELAY], t->is_new = true;
    bool crosses = crossing(t) <= t->time + 1e-9;
    if (crosses) t->crossings++;
    t->active[SENT] = t->active[SAMPLE] || t->active[ALARM] || crosses || (t->active[RECEIVED] && t->echo);
    if (t->active[SENT]) t->integers[SENTS]++, t->reals[VALUE] = t->reals[SEEN] + 1;
    t->integers[FOLLOWED] = t->integers[LEVEL];
}

int fmi3EvaluateDiscreteStates(Ticker *t) {
    CHECK(t->state == EVENT);
    return compute(t), 0;
}

int fmi3UpdateDiscreteStates(Ticker *t, bool *again, bool *terminate, bool *nominals, bool *states, bool *has_next,
                             double *next) {
    CHECK(t->state == EVENT);
    compute(t);
    *again = *terminate = *nominals = *states = *has_next = false;
    *next = 0;
    t->integers[UPDATES]++;
    memset(t->active, 0, sizeof t->active);
    return t->is_computed = false, 0;
}

int fmi3SetClock(Ticker *t, References r, size_t n, const bool *values) {
    CHECK(t->state == EVENT && !t->is_computed);
    for (size_t i = 0; i < n; i++) {
        CHECK(r[i] >= SAMPLE && r[i] <= ALARM);
        CHECK(r[i] == RECEIVED || fabs(t->due[r[i]] - t->time) < 1e-9);
        t->active[r[i]] = values[i];
        if (r[i] == ALARM) t->due[ALARM] = -1;
#if defined TUNABLE
        if (r[i] == SAMPLE) t->due[SAMPLE] += t->reals[INTERVAL];
#elif defined CHANGING
        if (r[i] == SAMPLE) t->due[SAMPLE] += (t->integers[SAMPLES] + 2) * t->reals[INTERVAL];
#else
        if (r[i] == SAMPLE) t->due[SAMPLE] = t->start + t->reals[SHIFT] + (t->integers[SAMPLES] + 1) * t->reals[INTERVAL];
#endif
    }
    return 0;
}

int fmi3GetClock(Ticker *t, References r, size_t n, bool *values) {
    CHECK(t->state == EVENT);
    compute(t);
    for (size_t i = 0; i < n; i++) values[i] = t->active[r[i]];
    return 0;
}

int fmi3GetIntervalDecimal(Ticker *t, References r, size_t n, double *intervals, int *qualifiers) {
    CHECK(t->state == EVENT || t->state == INITIALIZATION);
    CHECK(n == 1 && (r[0] == SAMPLE || r[0] == ALARM));
    if (r[0] == ALARM) {
        *qualifiers = t->due[ALARM] < 0 ? 0 : t->is_new ? 2 : 1;
        *intervals = t->due[ALARM] - t->time;
#ifdef PENDING_IS_NAN
        if (*qualifiers == 1) *intervals = NAN;
#endif
#ifdef PENDING_IS_UNKNOWN
        if (*qualifiers == 1) *qualifiers = 0;
#endif
        return t->is_new = false, 0;
    }
    *intervals = t->reals[INTERVAL];
    *qualifiers = t->told == *intervals ? 1 : 2;
    t->told = *intervals;
#ifdef CHANGING
    *intervals = t->due[SAMPLE] - t->time;
#endif
#ifdef NEVER_KNOWN
    *qualifiers = 0;
#endif
#ifdef NOT_A_NUMBER
    *intervals = NAN;
#endif
    return 0;
}

int fmi3GetShiftDecimal(Ticker *t, References r, size_t n, double *shifts) {
    CHECK(t->state == INITIALIZATION && n == 1 && r[0] == SAMPLE);
    return *shifts = t->reals[SHIFT], 0;
}

int fmi3DoStep(Ticker *t, double time, double step, bool final, bool *event, bool *terminate, bool *early, double *last) {
    (void)final;
    CHECK(t->state == STEP && fabs(time - t->time) < 1e-9 && step > 0);
    double end = time + step, reached = fmin(end, crossing(t));
    /* The host must not step over ticks. */
    CHECK(end < t->due[SAMPLE] + 1e-9 && (t->due[ALARM] < 0 || end < t->due[ALARM] + 1e-9));
    t->reals[SUM] += (reached - time) * t->reals[U];
    t->integers[STEPS]++;
    t->time = *last = reached;
    *early = reached < end - 1e-12;
    *event = crossing(t) <= reached + 1e-12;
    return *terminate = false, 0;
}

/* Whether a clocked variable may be accessed, as any other one. */
static bool is_accessible(const Ticker *t, unsigned int r) {
    if (t->state != STEP && t->state != EVENT) return true;
    if (r == MESSAGE) return t->active[RECEIVED];
    return r != VALUE || t->active[SENT];
}

int fmi3GetFloat64(Ticker *t, References r, size_t n, double *values, size_t count) {
    if (t->state == EVENT) compute(t);
    for (size_t i = 0; i < n && i < count; i++) {
        CHECK(is_accessible(t, r[i]));
        values[i] = t->reals[r[i]];
    }
    return 0;
}

int fmi3SetFloat64(Ticker *t, References r, size_t n, const double *values, size_t count) {
    for (size_t i = 0; i < n && i < count; i++) {
        CHECK(is_accessible(t, r[i]));
        if (r[i] == INTERVAL && t->state == EVENT && values[i] != t->reals[INTERVAL]) t->due[SAMPLE] = t->time + values[i];
        t->reals[r[i]] = values[i];
    }
    return 0;
}

int fmi3GetInt32(Ticker *t, References r, size_t n, int32_t *values, size_t count) {
    if (t->state == EVENT) compute(t);
    for (size_t i = 0; i < n && i < count; i++) values[i] = t->integers[r[i]];
    return 0;
}

int fmi3GetFMUState(Ticker *t, void **state) {
    if (!*state) *state = malloc(sizeof *t);
    return memcpy(*state, t, sizeof *t), 0;
}

int fmi3SetFMUState(Ticker *t, const void *state) { return memcpy(t, state, sizeof *t), 0; }
int fmi3FreeFMUState(Ticker *t, void **state) { return (void)t, free(*state), *state = NULL, 0; }

int fmi3SetInt32(Ticker *t, References r, size_t n, const int32_t *values, size_t count) {
    CHECK(t->state != STEP);
    for (size_t i = 0; i < n && i < count; i++) t->integers[r[i]] = values[i];
    return 0;
}

int fmi3SetBoolean(Ticker *t, References r, size_t n, const bool *values, size_t count) {
    for (size_t i = 0; i < n && i < count; i++) {
        CHECK(r[i] == ECHO);
        t->echo = values[i];
    }
    return 0;
}
