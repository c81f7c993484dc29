/* An FMU of FMI 3.0 with scheduled execution: three model partitions, which count their ticks.
 *
 *     time        0 1 2 3 4 5 6 7 8 9
 *     second      + + + + + + + + + +   constant, 1 s
 *     call        the host ticks it     triggered
 *     delayed             +             countdown, `delay` after the tick of `second` at 4 s
 *     fifth                             output: at every fifth tick of an input clock
 *
 * As the standard allows, it refuses all calls in other states, and tells once only that an output clock has ticked or
 * that an interval is new. A defect is chosen by its name: cc -DKEEPS_LOCK ...
 */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum { SECOND = 1, CALL, DELAYED, FIFTH, SECONDS, CALLS, DELAYS, TOTAL, SUM, ADDEND, DELAY, LOG };
#ifndef EVERY
#define EVERY 5
#endif

enum { OK, ERROR = 3 };
enum { INSTANTIATED, INITIALIZATION, ACTIVATION, UPDATE };

typedef struct {
    int state;
    int32_t seconds, calls, delays, total, sum, addend;
    double delay, last[FIFTH], log;
    bool fifth, is_delayed;
    void *environment;
    void (*update)(void *), (*lock)(void), (*unlock)(void);
} Partitions;

typedef const unsigned int *References;

void *fmi3InstantiateScheduledExecution(const char *name, const char *token, const char *resources, bool visible,
                                        bool logging, void *environment, void *log, void (*update)(void *),
                                        void (*lock)(void), void (*unlock)(void)) {
    (void)name, (void)resources, (void)visible, (void)logging, (void)log;
    if (strcmp(token, "{partitions}") || !update || !lock || !unlock) return NULL;
    Partitions *p = calloc(1, sizeof *p);
    p->environment = environment;
    p->update = update, p->lock = lock, p->unlock = unlock;
    for (int clock = 0; clock < FIFTH; clock++) p->last[clock] = -1;
    return p;
}

void fmi3FreeInstance(void *instance) { free(instance); }

int fmi3EnterInitializationMode(Partitions *p) {
    if (p->state != INSTANTIATED) return ERROR;
    return p->state = INITIALIZATION, OK;
}

int fmi3ExitInitializationMode(Partitions *p) {
    if (p->state != INITIALIZATION) return ERROR;
    return p->state = ACTIVATION, OK;
}

int fmi3Terminate(Partitions *p) { return p->state == ACTIVATION ? OK : ERROR; }

static void update_clocks(Partitions *p) {
    if (!p->fifth && !p->is_delayed) return;
    p->state = UPDATE;
    p->update(p->environment);
    p->state = ACTIVATION;
}

int fmi3ActivateModelPartition(Partitions *p, unsigned int clock, double time) {
    if (p->state != ACTIVATION || clock < SECOND || clock > DELAYED || time <= p->last[clock]) return ERROR;
    p->last[clock] = time;
    p->lock();
    p->lock();
    p->total++;
    if (clock == SECOND) p->seconds++, p->is_delayed = time == 4;
    if (clock == CALL) p->calls++, p->sum += p->addend;
    if (clock == DELAYED) p->delays++;
    p->fifth = p->total % EVERY == 0;
    p->log = 10 * p->log + clock;
    p->unlock();
#ifndef KEEPS_LOCK
    p->unlock();
#endif
    update_clocks(p);
    return OK;
}

int fmi3GetClock(Partitions *p, References r, size_t n, bool *values) {
    if (p->state != UPDATE || n != 1 || r[0] != FIFTH) return ERROR;
    values[0] = p->fifth;
    return p->fifth = false, OK;
}

int fmi3GetIntervalDecimal(Partitions *p, References r, size_t n, double *intervals, int *qualifiers) {
    if ((p->state != UPDATE && p->state != INITIALIZATION) || n != 1 || r[0] != DELAYED) return ERROR;
    qualifiers[0] = p->is_delayed ? 2 : p->seconds > 4;
#ifdef STRANGE_QUALIFIER
    if (p->is_delayed) qualifiers[0] = 7;
#endif
    if (p->is_delayed) intervals[0] = p->delay;
    return p->is_delayed = false, OK;
}

int fmi3GetInt32(Partitions *p, References r, size_t n, int32_t *values, size_t count) {
    const int32_t own[] = {p->seconds, p->calls, p->delays, p->total, p->sum, p->addend};
    for (size_t i = 0; i < n && i < count; i++) {
        if (r[i] < SECONDS || r[i] > ADDEND) return ERROR;
        values[i] = own[r[i] - SECONDS];
    }
    return OK;
}

int fmi3SetInt32(Partitions *p, References r, size_t n, const int32_t *values, size_t count) {
    if (n != 1 || count != 1 || r[0] != ADDEND) return ERROR;
    return p->addend = values[0], OK;
}

int fmi3GetFloat64(Partitions *p, References r, size_t n, double *values, size_t count) {
    if (n != 1 || count != 1 || r[0] != LOG) return ERROR;
    return values[0] = p->log, OK;
}

int fmi3SetFloat64(Partitions *p, References r, size_t n, const double *values, size_t count) {
    if (n != 1 || count != 1 || r[0] != DELAY) return ERROR;
    return p->delay = values[0], OK;
}
