/* A co-simulation FMU of FMI 3.0 with event mode. It beats every `period` s, and follows a discrete input at events:
 *
 *     beats = number of beats        seen = level at the last event        x' = seen
 *
 * A step ends early at a beat, if that is allowed. Beats are counted in event mode only, where alone `level` may be set.
 * It has only the functions that the master calls. A defect is chosen by its name: cc -DNEVER_STABLE ...
 */
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum { PERIOD = 1, LEVEL, X, SEEN, BEATS, UPDATES };

typedef struct {
    double values[SEEN + 1], time, start;
    int32_t beats, updates;
    bool is_in_event_mode, announces;
} Beats;

typedef const unsigned int *References;

void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible,
                                  bool logging, bool events, bool early, References intermediate, size_t n,
                                  void *environment, void *log, void *update) {
    (void)name, (void)resources, (void)visible, (void)logging, (void)intermediate, (void)n;
    (void)environment, (void)log, (void)update;
    if (strcmp(token, "{beats}") || !events || !early) return NULL;
    Beats *beats = calloc(1, sizeof *beats);
    beats->values[PERIOD] = 0.25;
    return beats;
}

void fmi3FreeInstance(void *instance) { free(instance); }

int fmi3EnterInitializationMode(Beats *b, bool has_tolerance, double tolerance, double start) {
    (void)has_tolerance, (void)tolerance;
    b->time = b->start = start;
    return 0;
}

int fmi3ExitInitializationMode(Beats *b) { return b->is_in_event_mode = true, 0; }
int fmi3Terminate(Beats *b) { return (void)b, 0; }

int fmi3EnterEventMode(Beats *b) {
    if (b->is_in_event_mode) return 3;
    return b->is_in_event_mode = true, 0;
}

int fmi3EnterStepMode(Beats *b) {
    if (!b->is_in_event_mode) return 3;
    return b->is_in_event_mode = false, 0;
}

static double next(const Beats *b) { return b->start + (b->beats + 1) * b->values[PERIOD]; }

int fmi3UpdateDiscreteStates(Beats *b, bool *again, bool *terminate, bool *nominals, bool *states, bool *has_next,
                             double *next_event) {
    if (!b->is_in_event_mode) return 3;
    *nominals = *states = false;
    *terminate = b->values[LEVEL] == 99;
    b->updates++;
    b->values[SEEN] = b->values[LEVEL];
    if (next(b) <= b->time + 1e-12) b->beats++;
#ifdef NEVER_STABLE
    *again = true;
#else
    *again = next(b) <= b->time + 1e-12;
#endif
#ifdef ANNOUNCES
    *has_next = true;
#else
    *has_next = false;
#endif
    *next_event = next(b);
    return 0;
}

int fmi3DoStep(Beats *b, double time, double step, bool final, bool *event, bool *terminate, bool *early,
               double *last) {
    (void)final;
    if (b->is_in_event_mode || fabs(time - b->time) > 1e-9 || step <= 0) return 3;
    double end = time + step, reached = fmin(end, next(b));
#ifdef ANNOUNCES
    /* The master must not step over a beat that it knows. */
    if (end > next(b) + 1e-9) return 3;
#endif
#ifdef STALLS
    reached = time;
#endif
    b->values[X] += (reached - time) * b->values[SEEN];
    b->time = *last = reached;
    *early = reached < end - 1e-12;
    *event = next(b) <= reached + 1e-12;
    *terminate = false;
    return 0;
}

int fmi3GetFloat64(Beats *b, References r, size_t n, double *values, size_t count) {
    for (size_t i = 0; i < n && i < count; i++) values[i] = b->values[r[i]];
    return 0;
}

int fmi3SetFloat64(Beats *b, References r, size_t n, const double *values, size_t count) {
    for (size_t i = 0; i < n && i < count; i++) {
        if (r[i] == LEVEL && b->time > b->start && !b->is_in_event_mode) return 3;
        b->values[r[i]] = values[i];
    }
    return 0;
}

int fmi3GetInt32(Beats *b, References r, size_t n, int32_t *values, size_t count) {
    for (size_t i = 0; i < n && i < count; i++) values[i] = r[i] == BEATS ? b->beats : b->updates;
    return 0;
}
