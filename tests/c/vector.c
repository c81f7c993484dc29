/* A co-simulation FMU of FMI 3.0 that adds the parameter c and the input a, arrays of n elements, to the output w in
 * each step, and counts its steps at events. n is a structural parameter. The output y is twice the input u. A defect
 * is chosen by its name: cc -DLENGTHS ... */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#ifdef RANDOM
#include <unistd.h>
#define NOISE getpid()
#else
#define NOISE 0
#endif

enum { OK, ERROR = 3, MOST = 8 };
#ifndef START_W
#define START_W 0
#endif

enum { W = 1, C = 2, N = 3, TIME = 4, U = 5, Y = 6, COUNT = 7, A = 8, BIG = 9 };

typedef struct {
    uint64_t n;
    double w[MOST], c[MOST], a[MOST], time, u;
    bool is_running, is_late, event_mode;
    int steps, count;
    int64_t big;
    void (*update)(void *, double, bool, bool, bool, bool, bool *, double *);
    void *environment;
} Vector;

typedef const unsigned *References;

static void restart(Vector *v) {
    const uint64_t n = v->n;
    (void)n;
    const Vector start = {3, {START_W}, {1, 2, 3, 4, 5, 6, 7, 8}, {0}, 0, 0, false, false, v->event_mode, 0, 0, 0, v->update, v->environment};
    const Vector old = *v;
    (void)old;
    *v = start;
#ifdef RESET
    v->w[1] = old.w[1];
#elif defined RESET_PARAMETER
    if (old.n) v->c[1] = old.c[1];
#elif defined RESET_INPUT
    v->a[1] = old.a[1];
#endif
#ifdef RESET_SIZE
    v->n = n ? n : v->n;
#endif
#ifdef START
    v->c[2] = 2.5;
#endif
}

void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible,
                                  bool logging, bool events, bool early, References intermediate, size_t n,
                                  void *environment, void *log,
                                  void (*update)(void *, double, bool, bool, bool, bool, bool *, double *)) {
    (void)resources, (void)visible, (void)logging, (void)early, (void)intermediate, (void)n, (void)log;
    if (!name || !token || strcmp(token, "{vector}")) return NULL;
#ifdef CLOCKED
    if (!events) return NULL;
#endif
    Vector *v = calloc(1, sizeof *v);
    v->event_mode = events, v->update = update, v->environment = environment;
    restart(v);
    return v;
}

#ifdef UNLOAD
__attribute__((destructor)) static void unload(void) { abort(); }
#endif

void fmi3FreeInstance(void *instance) { free(instance); }

const char *fmi3GetVersion(void) { return "3.0"; }

int fmi3Reset(Vector *v) { return restart(v), OK; }

int fmi3EnterInitializationMode(Vector *v, bool has_tolerance, double tolerance, double start,
                                bool has_stop, double stop) {
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop;
#ifdef START_TIME
    start = 0;
#endif
#ifdef LATE_START
    v->is_late = start > 0;
#endif
    v->time = start;
    return OK;
}

int fmi3ExitInitializationMode(Vector *v) { return v->is_running = true, OK; }

int fmi3Terminate(Vector *v) { return (void)v, OK; }

int fmi3DoStep(Vector *v, double time, double step, bool final, bool *event, bool *terminate, bool *early,
               double *last) {
    (void)final;
    if (v->is_late) return ERROR;
    if (!(step >= 0 && step < 1e3) || time < v->time - 1e-6 || time > v->time + 1e-6) return ERROR;
    for (size_t i = 0; i < v->n; i++) v->w[i] += step * (v->c[i] + v->a[i]);
    *terminate = *early = false;
    *event = v->event_mode;
    *last = v->time = time + step;
    v->steps++;
    if (!v->event_mode) v->count = v->steps;
#ifdef DRIFT
    v->c[1] *= 1 + 1e-3 * step;
#endif
#ifdef DISCRETE
    v->count = v->steps;
#elif defined EVENT_NEEDED
    *event = true;
#elif defined LAST_TIME
    *last = time;
#elif defined EARLY
    *early = step > 2e-9;
    if (*early) *last = v->time = time + step / 2;
#elif defined EARLY_ACROSS
    *early = v->event_mode && step > 0.015;
    if (*early) *last = v->time = time + step / 2;
#elif defined BEYOND
    *early = true;
    *last = time + 1.5 * step;
#elif defined EARLY_AT_END
    *early = true;
#elif defined INTERMEDIATE
    bool requested = false;
    double until = 0;
    if (v->update) v->update(v->environment, v->time, false, true, true, false, &requested, &until);
#endif
    return OK;
}

/* The time that the solver has reached. */
static double reached(const Vector *v) {
#ifdef OWN_STEPS
    return (int)(v->time * 10 + 1e-6) / 10.0;
#else
    return v->time;
#endif
}

static double *array(Vector *v, unsigned reference) { return reference == W ? v->w : reference == A ? v->a : v->c; }

int fmi3GetFloat64(Vector *v, References r, size_t n, double *values, size_t count) {
    for (size_t i = 0; i < n; i++) {
        if (r[i] >= TIME && r[i] <= Y) {
            if (!count--) return ERROR;
            *values++ = r[i] == TIME ? reached(v) : r[i] == U ? v->u : 2 * v->u + NOISE;
            continue;
        }
        if (r[i] != W && r[i] != C && r[i] != A) return ERROR;
#ifdef LENGTHS
        const size_t size = count < v->n ? count : v->n;
#elif defined SIZES
        const size_t size = v->n == 3 ? 3 : MOST;
#else
        const size_t size = v->n;
#endif
        if (count < size) return ERROR;
        memcpy(values, array(v, r[i]), size * sizeof *values);
        values += size, count -= size;
    }
#ifdef LENGTHS
    return OK;
#else
    return count ? ERROR : OK;
#endif
}

int fmi3SetFloat64(Vector *v, References r, size_t n, const double *values, size_t count) {
    if (n == 0) return OK;
#ifdef SET_LENGTHS
    if (n == 1 && r[0] == C && count != v->n) return OK;
#endif
    for (size_t i = 0; i < n; i++) {
        size_t size = r[i] == U ? 1 : v->n;
        if (count < size || (r[i] != U && r[i] != C && r[i] != A)) return ERROR;
        values += size, count -= size;
    }
    if (count) return ERROR;
    for (size_t i = n; i-- > 0;) {
        size_t size = r[i] == U ? 1 : v->n;
        values -= size;
#ifdef KEPT
        if (r[i] == C) size--;
#endif
        memcpy(r[i] == U ? &v->u : array(v, r[i]), values, size * sizeof *values);
    }
    return OK;
}

int fmi3GetInt32(Vector *v, References r, size_t n, int32_t *values, size_t count) {
    if (n != 1 || r[0] != COUNT || count != 1) return n ? ERROR : OK;
    return *values = v->count, OK;
}

int fmi3EnterEventMode(Vector *v) { return v->event_mode ? OK : ERROR; }

int fmi3EnterStepMode(Vector *v) {
#ifdef NO_STEP_MODE
    return ERROR;
#endif
    return v->event_mode ? OK : ERROR;
}

int fmi3UpdateDiscreteStates(Vector *v, bool *again, bool *terminate, bool *nominals, bool *states, bool *next,
                             double *time) {
    *again = *terminate = *nominals = *states = *next = false;
    *time = 0;
    v->count = v->steps;
    return v->event_mode ? OK : ERROR;
}

int fmi3GetUInt64(Vector *v, References r, size_t n, uint64_t *values, size_t count) {
    if (n != 1 || r[0] != N || count != 1) return ERROR;
    return *values = v->n, OK;
}

int fmi3SetUInt64(Vector *v, References r, size_t n, const uint64_t *values, size_t count) {
    if (n != 1 || r[0] != N || count != 1 || *values < 1 || *values > MOST) return ERROR;
    return v->n = *values, OK;
}

int fmi3GetInt64(Vector *v, References r, size_t n, int64_t *values, size_t count) {
    if (n != 1 || r[0] != BIG || count != 1) return ERROR;
    return *values = v->big, OK;
}

int fmi3SetInt64(Vector *v, References r, size_t n, const int64_t *values, size_t count) {
    if (n != 1 || r[0] != BIG || count != 1) return ERROR;
#ifdef ROUNDED
    return v->big = (int64_t)(double)*values, OK;
#else
    return v->big = *values, OK;
#endif
}

int fmi3EnterConfigurationMode(Vector *v) { return v->is_running ? ERROR : OK; }

int fmi3ExitConfigurationMode(Vector *v) { return (void)v, OK; }

int fmi3GetFMUState(Vector *v, Vector **state) {
    if (!*state) *state = malloc(sizeof *v);
    return **state = *v, OK;
}

int fmi3SetFMUState(Vector *v, const Vector *state) {
    const Vector old = *v;
    (void)old;
    *v = *state;
#ifdef STATE
    v->w[1] = old.w[1];
#elif defined STATE_PARAMETER
    v->c[1] = old.c[1];
#elif defined STATE_INPUT
    v->a[1] = old.a[1];
#endif
    return OK;
}

int fmi3FreeFMUState(Vector *v, Vector **state) {
    (void)v;
    free(*state);
    return *state = NULL, OK;
}

int fmi3GetDirectionalDerivative(Vector *v, References of, size_t n, References by, size_t m,
                                 const double *seed, size_t n_seed, double *values, size_t count) {
    (void)v, (void)seed;
    if (n == 0 && m == 0) return OK;
    if (n != 1 || m != 1 || n_seed != 1 || count != 1 || of[0] != Y || by[0] != U) return ERROR;
#ifdef SEED
    return *values = 2, OK;
#else
    return *values = 2 * *seed, OK;
#endif
}

int fmi3GetAdjointDerivative(Vector *v, References of, size_t n, References by, size_t m, const double *seed,
                             size_t n_seed, double *values, size_t count) {
    const int status = fmi3GetDirectionalDerivative(v, of, n, by, m, seed, n_seed, values, count);
#ifdef ADJOINT_SEED
    if (n) *values = 2;
#elif defined ADJOINT
    if (n) *values = -2 * *seed;
#else
    if (n) *values = 2 * *seed;
#endif
    return status;
}

int fmi3SetDebugLogging(void) { return OK; }

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
STUBS(Boolean)
STUBS(String)
STUBS(Binary)
#ifdef CLOCKED
STUB(GetClock)
int fmi3SetClock(Vector *v, const unsigned *r, size_t n, const bool *values) {
    (void)v, (void)values;
    return n == 1 && *r == 20 ? OK : ERROR;
}
#else
STUBS(Clock)
#endif
STUBS(IntervalDecimal)
STUBS(IntervalFraction)
STUBS(ShiftDecimal)
STUBS(ShiftFraction)
STUB(GetNumberOfVariableDependencies)
STUB(GetVariableDependencies)
STUB(SerializedFMUStateSize)
STUB(SerializeFMUState)
STUB(DeserializeFMUState)
STUB(EvaluateDiscreteStates)
STUB(GetOutputDerivatives)
#define NO_INSTANCE(name) \
    void *fmi3Instantiate##name(void) { return NULL; }
NO_INSTANCE(ModelExchange)
NO_INSTANCE(ScheduledExecution)
