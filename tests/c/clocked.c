/* An FMU of FMI 3.0 with clocks of most kinds, for co-simulation and scheduled execution, whose outputs count their
 * ticks. A node of a CAN bus sends a frame whenever the countdown clock ticks. A defect of `clock_defects.h` is chosen
 * by its name: cc -DDEFECT=INTERVAL_ZERO ... */
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define PLANT(name, interface, rule, text) name,
enum { NO_DEFECT,
#include "clock_defects.h"
};
#ifndef DEFECT
#define DEFECT NO_DEFECT
#endif

enum { OK, ERROR = 3 };
enum { TIME, SAMPLE, CALCULATED, CHANGING, COUNTDOWN, RECEIVED, SENT, CLOCKS };
enum { U = 10, Y, CALCULATED_TICKS, CHANGING_TICKS, RX, TX, RECEIVED_BYTES, LEVEL };
enum { NOT_YET_KNOWN, UNCHANGED, CHANGED };
enum Mode { INSTANTIATED, INITIALIZATION, EVENT, STEP, ACTIVATION, TERMINATED };
enum { SIZE = 24, MOST = 96 };

typedef const unsigned *References;

/* What belongs to the state of the FMU. */
typedef struct {
    enum Mode mode;
    double time, u, level, activated[CLOCKS], interval;
    bool active[CLOCKS];
    int before[CLOCKS], ticks[CLOCKS], qualifier[CLOCKS], received, count;
} Data;

typedef struct {
    Data data;
    bool is_scheduled, is_updating;
    void *environment;
    void (*update)(void *), (*lock)(void), (*unlock)(void);
    uint8_t tx[MOST];
    size_t size;
} Clocked;

static void restart(Clocked *c) {
    const int ticks = c->data.before[SAMPLE];
    c->data = (Data){0};
    c->data.qualifier[CALCULATED] = c->data.qualifier[CHANGING] = CHANGED;
    c->data.interval = 0.04;
    for (int k = 0; k < CLOCKS; k++) c->data.activated[k] = -INFINITY;
    if (DEFECT == RESET_KEEPS_TICKS) c->data.before[SAMPLE] = c->data.ticks[SAMPLE] = ticks;
}

static Clocked *instantiate(const char *name, const char *token, void *environment) {
    if (!name || !token || strcmp(token, "{clocked}")) return NULL;
    Clocked *c = calloc(1, sizeof *c);
    c->environment = environment;
    restart(c);
    return c;
}

Clocked *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible,
                                     bool logging, bool events, bool early, References intermediate, size_t n,
                                     void *environment, void *log, void *update) {
    (void)resources, (void)visible, (void)logging, (void)early, (void)intermediate, (void)n, (void)log, (void)update;
    return events ? instantiate(name, token, environment) : NULL;
}

Clocked *fmi3InstantiateScheduledExecution(const char *name, const char *token, const char *resources, bool visible,
                                           bool logging, void *environment, void *log, void (*update)(void *),
                                           void (*lock)(void), void (*unlock)(void)) {
    (void)resources, (void)visible, (void)logging, (void)log;
    Clocked *c = instantiate(name, token, environment);
    if (c) c->is_scheduled = true, c->update = update, c->lock = lock, c->unlock = unlock;
    return c;
}

void *fmi3InstantiateModelExchange(void) { return NULL; }
void fmi3FreeInstance(void *instance) { free(instance); }
const char *fmi3GetVersion(void) { return "3.0"; }
int fmi3SetDebugLogging(void) { return OK; }
int fmi3Reset(Clocked *c) { return restart(c), OK; }

int fmi3EnterInitializationMode(Clocked *c, bool has_tolerance, double tolerance, double start, bool has_stop,
                                double stop) {
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop;
    if (c->data.mode != INSTANTIATED) return ERROR;
    c->data.mode = INITIALIZATION, c->data.time = start;
    if (DEFECT == UPDATE_OUTSIDE && c->update) c->update(c->environment);
    return OK;
}

int fmi3ExitInitializationMode(Clocked *c) {
    if (c->data.mode != INITIALIZATION) return ERROR;
    return c->data.mode = c->is_scheduled ? ACTIVATION : EVENT, OK;
}

static int change(Clocked *c, enum Mode from, enum Mode to) {
    if (c->data.mode != from) return ERROR;
    return c->data.mode = to, OK;
}

int fmi3EnterEventMode(Clocked *c) { return change(c, STEP, EVENT); }
int fmi3EnterStepMode(Clocked *c) { return change(c, EVENT, STEP); }

int fmi3Terminate(Clocked *c) {
    if (c->data.mode < EVENT || c->data.mode == TERMINATED) return ERROR;
    return c->data.mode = TERMINATED, OK;
}

int fmi3DoStep(Clocked *c, double time, double step, bool final, bool *event, bool *terminate, bool *early,
               double *last) {
    (void)final;
    const bool steps = c->data.mode == STEP || (DEFECT == STEPS_IN_EVENT_MODE && c->data.mode == EVENT);
    if (!steps || !(step > 0 && step < 1e3) || !(fabs(time - c->data.time) < 1e-9)) return ERROR;
    *event = *terminate = *early = false;
    *last = c->data.time = time + step;
    if (DEFECT == CLOCKED_CHANGES) c->data.ticks[SAMPLE]++, c->data.before[SAMPLE]++;
    return OK;
}

/* The discrete states, which depend on those before the tick. */
static void evaluate(Clocked *c) {
    Data *d = &c->data;
    for (int k = SAMPLE; k < CLOCKS; k++) {
        d->ticks[k] = (DEFECT == EVALUATION_COUNTS ? d->ticks[k] : d->before[k]) + d->active[k];
    }
    if (DEFECT == PARTITION_TOUCHES_OTHERS && d->active[SAMPLE]) d->ticks[CHANGING]++;
    if (d->active[COUNTDOWN] && DEFECT != NEVER_SENT) d->active[SENT] = true;
}

int fmi3EvaluateDiscreteStates(Clocked *c) {
    if (c->data.mode != EVENT) return ERROR;
    return evaluate(c), OK;
}

/* Ends a tick; returns whether there is a new interval of the countdown clock. */
static bool commit(Clocked *c) {
    Data *d = &c->data;
    memcpy(d->before, d->ticks, sizeof d->before);
    bool starts = d->active[SAMPLE] && d->ticks[SAMPLE] % 4 == 1;
    if (DEFECT == COUNTDOWN_OF_ZERO) starts |= d->active[COUNTDOWN];
    if (d->active[SAMPLE]) d->level = d->u;
    if (d->active[CHANGING] && DEFECT != INTERVAL_NOT_GIVEN_AGAIN) {
        d->qualifier[CHANGING] = CHANGED, d->interval = 0.1 - d->interval;
    }
    if (d->active[COUNTDOWN]) d->qualifier[COUNTDOWN] = NOT_YET_KNOWN;
    if (starts) d->qualifier[COUNTDOWN] = CHANGED;
    const bool sent = d->active[SENT] && (c->is_scheduled || DEFECT == CLOCK_STAYS_ACTIVE);
    memset(d->active, 0, sizeof d->active);
    d->active[SENT] = sent;
    return starts;
}

int fmi3UpdateDiscreteStates(Clocked *c, bool *again, bool *terminate, bool *nominals, bool *states, bool *next,
                             double *time) {
    if (c->data.mode != EVENT) return ERROR;
    if (DEFECT != EVALUATION_COUNTS) evaluate(c);
    commit(c);
    *again = *terminate = *nominals = *states = *next = false;
    *again = DEFECT == EVENTS_NEVER_END;
    return *time = 0, OK;
}

int fmi3ActivateModelPartition(Clocked *c, unsigned clock, double time) {
    Data *d = &c->data;
    if (d->mode != ACTIVATION && DEFECT != PARTITION_TOO_EARLY) return ERROR;
    if (clock < SAMPLE || clock > (DEFECT == PARTITION_OF_OUTPUT ? SENT : RECEIVED)) return ERROR;
    if (!(time > d->activated[clock]) && DEFECT != PARTITION_BACKWARDS) return ERROR;
    while (DEFECT == PARTITION_HANGS && time > 0.5) continue;
    if (c->lock) c->lock();
    d->activated[clock] = d->time = time;
    d->active[clock] = true;
    evaluate(c);
    const bool starts = commit(c);
    const bool updates = starts || d->active[SENT] || DEFECT == UPDATE_WITHOUT_REASON;
    if (c->unlock && DEFECT != LOCK_KEPT) c->unlock();
    c->is_updating = true;
    if (updates && c->update) c->update(c->environment);
    c->is_updating = false;
    d->active[SENT] = false;
    return OK;
}

/* Clocks. */

int fmi3GetClock(Clocked *c, References r, size_t n, bool *values) {
    Data *d = &c->data;
    if (c->is_scheduled ? !c->is_updating : d->mode != EVENT) return ERROR;
    if (!c->is_scheduled) evaluate(c);
    for (size_t i = 0; i < n; i++) {
        if (r[i] < SAMPLE || r[i] >= CLOCKS) {
            if (DEFECT != UNKNOWN_CLOCK_READ) return ERROR;
            values[i] = false;
            continue;
        }
        values[i] = d->active[r[i]];
        const bool keeps = c->is_scheduled ? DEFECT == CLOCK_ACTIVE_TWICE : DEFECT != CLOCK_ACTIVE_ONCE;
        if (r[i] == SENT && !keeps) d->active[COUNTDOWN] = d->active[SENT] = false;
    }
    return OK;
}

int fmi3SetClock(Clocked *c, References r, size_t n, const bool *values) {
    if (c->data.mode != EVENT) return ERROR;
    for (size_t i = 0; i < n; i++) {
        if (r[i] < SAMPLE || r[i] > (DEFECT == OUTPUT_CLOCK_SETTABLE ? SENT : RECEIVED)) return ERROR;
        if (DEFECT == TICK_REFUSED && r[i] == SAMPLE && values[i]) return ERROR;
    }
    for (size_t i = 0; i < n; i++) c->data.active[r[i]] = values[i];
    return OK;
}

static double interval(const Clocked *c, unsigned clock) {
    if (clock == CALCULATED) return DEFECT == INTERVAL_ZERO ? 0 : 0.05;
    if (clock == CHANGING) return c->data.interval;
    if (clock == SAMPLE) return 0.03;
    if (DEFECT == COUNTDOWN_OF_ZERO) return 0;
    return DEFECT == INTERVAL_NAN ? NAN : DEFECT == INTERVAL_NEGATIVE ? -1 : 0.015;
}

int fmi3GetIntervalDecimal(Clocked *c, References r, size_t n, double *intervals, int *qualifiers) {
    Data *d = &c->data;
    if (d->mode < INITIALIZATION || d->mode == TERMINATED) return ERROR;
    for (size_t i = 0; i < n; i++) {
        if (r[i] < SAMPLE || r[i] > COUNTDOWN) return ERROR;
        if (DEFECT == INTERVAL_REFUSED && r[i] == CHANGING) return ERROR;
        qualifiers[i] = r[i] == SAMPLE ? UNCHANGED : d->qualifier[r[i]];
        if (qualifiers[i] != NOT_YET_KNOWN) intervals[i] = interval(c, r[i]);
        if (qualifiers[i] == CHANGED) d->qualifier[r[i]] = UNCHANGED;
        if (DEFECT == QUALIFIER_UNKNOWN && r[i] == CHANGING) qualifiers[i] = 3;
        if (DEFECT == NEVER_KNOWN && r[i] == CALCULATED) qualifiers[i] = NOT_YET_KNOWN;
    }
    return OK;
}

int fmi3GetIntervalFraction(Clocked *c, References r, size_t n, uint64_t *counters, uint64_t *resolutions,
                            int *qualifiers) {
    if (DEFECT == FRACTION_REFUSED) return ERROR;
    for (size_t i = 0; i < n; i++) {
        if (r[i] != CALCULATED) return ERROR;
        double decimal;
        const int status = fmi3GetIntervalDecimal(c, r + i, 1, &decimal, qualifiers + i);
        if (status) return status;
        counters[i] = DEFECT == FRACTION_DIFFERS ? 6 : 5, resolutions[i] = 100;
    }
    return OK;
}

int fmi3GetShiftDecimal(Clocked *c, References r, size_t n, double *shifts) {
    if (c->data.mode < INITIALIZATION || DEFECT == SHIFT_REFUSED) return ERROR;
    for (size_t i = 0; i < n; i++) {
        if (r[i] != CALCULATED) return ERROR;
        shifts[i] = 0.01;
    }
    return OK;
}

int fmi3GetShiftFraction(Clocked *c, References r, size_t n, uint64_t *counters, uint64_t *resolutions) {
    for (size_t i = 0; i < n; i++) {
        double shift;
        const int status = fmi3GetShiftDecimal(c, r + i, 1, &shift);
        if (status) return status;
        counters[i] = 1, resolutions[i] = 100;
    }
    return OK;
}

/* Variables. */

/* Whether a variable with these clocks may be accessed. */
static bool is_open(const Clocked *c, int clock, int other) {
    const Data *d = &c->data;
    if (d->mode == INITIALIZATION || d->mode == ACTIVATION || d->mode == TERMINATED) return true;
    if (DEFECT == CLOCKED_CHANGES) return true;
    return d->mode == EVENT && (d->active[clock] || d->active[other]);
}

int fmi3GetFloat64(Clocked *c, References r, size_t n, double *values, size_t count) {
    if (n != count) return ERROR;
    for (size_t i = 0; i < n; i++) {
        if (r[i] == TIME) values[i] = c->data.time;
        else if (r[i] == LEVEL) values[i] = c->data.level;
        else if ((r[i] == U || r[i] == Y) && is_open(c, SAMPLE, SAMPLE)) {
            if (c->data.mode == EVENT) evaluate(c);
            values[i] = r[i] == U ? c->data.u : 2 * c->data.u + c->data.ticks[SAMPLE];
        } else return ERROR;
    }
    return OK;
}

int fmi3SetFloat64(Clocked *c, References r, size_t n, const double *values, size_t count) {
    if (n != count) return ERROR;
    const bool is_early = c->data.mode == INSTANTIATED;
    for (size_t i = 0; i < n; i++) {
        if (r[i] != U || !(is_early || is_open(c, SAMPLE, SAMPLE) || DEFECT == CLOCKED_SETTABLE)) return ERROR;
        if (!isfinite(values[i])) return ERROR;
        c->data.u = values[i];
    }
    return OK;
}

int fmi3GetInt32(Clocked *c, References r, size_t n, int32_t *values, size_t count) {
    if (n != count) return ERROR;
    for (size_t i = 0; i < n; i++) {
        const int clock = r[i] == CALCULATED_TICKS ? CALCULATED : r[i] == CHANGING_TICKS ? CHANGING : RECEIVED;
        if (r[i] != CALCULATED_TICKS && r[i] != CHANGING_TICKS && r[i] != RECEIVED_BYTES) return ERROR;
        if (!is_open(c, clock, clock)) return ERROR;
        if (c->data.mode == EVENT) evaluate(c);
        values[i] = clock == RECEIVED ? c->data.received : c->data.ticks[clock];
    }
    return OK;
}

int fmi3SetBinary(Clocked *c, References r, size_t n, const size_t *sizes, const uint8_t *const *values,
                  size_t count) {
    (void)values;
    if (n != count) return ERROR;
    for (size_t i = 0; i < n; i++) {
        if (r[i] != RX || !is_open(c, RECEIVED, RECEIVED) || sizes[i] > 64) return ERROR;
        c->data.received = (int)sizes[i];
    }
    return OK;
}

int fmi3GetBinary(Clocked *c, References r, size_t n, size_t *sizes, const uint8_t **values, size_t count) {
    if (n != count) return ERROR;
    for (size_t i = 0; i < n; i++) {
        if (r[i] != TX || !is_open(c, COUNTDOWN, SENT)) return ERROR;
        if (c->data.mode == EVENT) evaluate(c);
        /* CAN Transmit with the number of ticks: code, length, ID, Ide, Rtr, Data Length and 8 bytes. */
        const uint8_t frame[SIZE] = {[0] = DEFECT == OPERATION_UNKNOWN ? 0x77 : 0x10,
                                     [4] = DEFECT == OPERATION_TRUNCATED  ? 4
                                           : DEFECT == OPERATION_TOO_LONG ? 200
                                           : DEFECT == FRAME_TOO_LONG     ? SIZE + 1
                                                                          : SIZE,
                                     [8] = 1,
                                     [14] = DEFECT == FRAME_TOO_LONG ? 9 : 8,
                                     [16] = (uint8_t)c->data.ticks[COUNTDOWN]};
        memset(c->tx, 0, sizeof c->tx);
        memcpy(c->tx, frame, SIZE);
        c->size = DEFECT == BINARY_TOO_LARGE ? 72 : DEFECT == FRAME_TOO_LONG ? SIZE + 1 : SIZE;
        if (DEFECT == BINARY_TOO_LARGE) memcpy(c->tx + SIZE, frame, SIZE), memcpy(c->tx + 48, frame, SIZE);
        if (DEFECT == BINARY_GROWS && c->data.count++ % 2) c->size = 48, memcpy(c->tx + SIZE, frame, SIZE);
        sizes[i] = c->data.mode == INITIALIZATION ? 0 : c->size;
        values[i] = DEFECT == BINARY_NULL ? NULL : c->tx;
    }
    return OK;
}

/* States. */

int fmi3GetFMUState(Clocked *c, Data **state) {
    if (!*state) *state = malloc(sizeof **state);
    return **state = c->data, OK;
}

int fmi3SetFMUState(Clocked *c, const Data *state) {
    const Data old = c->data;
    c->data = *state;
    if (DEFECT == STATE_LOSES_TICKS) memcpy(c->data.before, old.before, sizeof old.before);
    if (DEFECT == STATE_LOSES_INTERVAL) c->data.interval = 0.1 - old.interval * 0.9;
    return OK;
}

int fmi3FreeFMUState(Clocked *c, Data **state) {
    (void)c;
    free(*state);
    return *state = NULL, OK;
}

int fmi3SerializedFMUStateSize(Clocked *c, const Data *state, size_t *size) {
    (void)c, (void)state;
    return *size = sizeof(Data) + 1, OK;
}

int fmi3SerializeFMUState(Clocked *c, const Data *state, uint8_t *bytes, size_t size) {
    (void)c;
    if (size != sizeof *state + 1) return ERROR;
    memcpy(bytes, state, sizeof *state);
    uint8_t sum = 7;
    for (size_t i = 0; i < sizeof *state; i++) sum = (uint8_t)(31 * sum + bytes[i]);
    return bytes[sizeof *state] = sum, OK;
}

int fmi3DeserializeFMUState(Clocked *c, const uint8_t *bytes, size_t size, Data **state) {
    (void)c;
    if (size != sizeof(Data) + 1) return ERROR;
    uint8_t sum = 7;
    for (size_t i = 0; i < sizeof(Data); i++) sum = (uint8_t)(31 * sum + bytes[i]);
    if (sum != bytes[sizeof(Data)]) return ERROR;
    if (!*state) *state = malloc(sizeof **state);
    memcpy(*state, bytes, sizeof **state);
    return OK;
}

#define STUB(name) \
    int fmi3##name(void) { return ERROR; }
#define STUBS(type) STUB(Get##type) STUB(Set##type)
STUBS(Float32)
STUBS(Int8)
STUBS(UInt8)
STUBS(Int16)
STUBS(UInt16)
STUB(SetInt32)
STUBS(UInt32)
STUBS(Int64)
STUBS(UInt64)
STUBS(Boolean)
STUBS(String)
STUB(SetIntervalDecimal)
STUB(SetIntervalFraction)
STUB(SetShiftDecimal)
STUB(SetShiftFraction)
STUB(GetNumberOfVariableDependencies)
STUB(GetVariableDependencies)
STUB(GetDirectionalDerivative)
STUB(GetAdjointDerivative)
STUB(EnterConfigurationMode)
STUB(ExitConfigurationMode)
STUB(GetOutputDerivatives)
