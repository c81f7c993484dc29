/* An FMU of FMI 3.0 whose variables of each type are elements of one array: a value reference is the
 * index of the first of them, and as many follow as there are values. Not all functions exist. */

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define N 8

typedef int Status;
enum { OK, WARNING, DISCARD, ERROR };
typedef void Log(void *environment, int status, const char *category, const char *message);
typedef void Update(void *environment, double time, bool set, bool get, bool finished, bool can_return,
                    bool *requested, double *at);

typedef struct {
    void *environment;
    Log *log;
    Update *update;
    double time;
    char *text;
    char experiment[128];
    float Float32[N];
    double Float64[N];
    int8_t Int8[N];
    uint8_t UInt8[N];
    int16_t Int16[N];
    uint16_t UInt16[N];
    int32_t Int32[N];
    uint32_t UInt32[N];
    int64_t Int64[N];
    uint64_t UInt64[N];
    uint8_t Boolean[N];
} Instance;

const char *fmi3GetVersion(void) { return "3.0"; }

static Instance *create(const char *name, const char *token, const char *resources, void *environment,
                        Log *log, Update *update, const char *options) {
    if (strcmp(token, "{token}") != 0) {
        if (log) {
            log(environment, ERROR, "logStatusError", "the token is wrong");
        }
        return NULL;
    }
    Instance *self = calloc(1, sizeof *self);
    self->environment = environment;
    self->log = log;
    self->update = update;
    char text[256];
    snprintf(text, sizeof text, "%s in %s, %s", name, resources ? resources : "NULL", options);
    if (log) {
        log(environment, OK, "logEvents", text);
    }
    return self;
}

void *fmi3InstantiateModelExchange(const char *name, const char *token, const char *resources,
                                   bool visible, bool logging, void *environment, Log *log) {
    (void)visible, (void)logging;
    return create(name, token, resources, environment, log, NULL, "model exchange");
}

void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources,
                                  bool visible, bool logging, bool events, bool early,
                                  const uint32_t *variables, size_t n, void *environment, Log *log,
                                  Update *update) {
    char text[128];
    snprintf(text, sizeof text, "visible %d, logging %d, events %d, early %d, variables %u of %zu",
             visible, logging, events, early, n > 0 ? variables[0] : 0, n);
    return create(name, token, resources, environment, log, update, text);
}

void fmi3FreeInstance(void *instance) {
    Instance *self = instance;
    if (self) {
        free(self->text);
    }
    free(self);
}

Status fmi3EnterInitializationMode(Instance *self, bool has_tolerance, double tolerance, double start,
                                   bool has_stop, double stop) {
    self->time = start;
    snprintf(self->experiment, sizeof self->experiment, "%d %g %g %d %g", has_tolerance, tolerance, start,
             has_stop, stop);
    return OK;
}

Status fmi3ExitInitializationMode(Instance *self) {
    self->log(self->environment, OK, "logEvents", self->experiment);
    return OK;
}

Status fmi3Terminate(Instance *self) { return self->time > 100 ? 5 : WARNING; }

/* Values are copied only if they fit. */
#define ACCESS(NAME, TYPE)                                                                               \
    Status fmi3Get##NAME(Instance *self, const uint32_t *r, size_t n, TYPE *values, size_t count) {      \
        if (n != 1 || r[0] + count > N) {                                                                \
            return n == 0 ? OK : ERROR;                                                                  \
        }                                                                                                \
        memcpy(values, self->NAME + r[0], count * sizeof(TYPE));                                         \
        return OK;                                                                                       \
    }                                                                                                    \
    Status fmi3Set##NAME(Instance *self, const uint32_t *r, size_t n, const TYPE *values, size_t count) { \
        if (n != 1 || r[0] + count > N) {                                                                \
            return n == 0 ? OK : ERROR;                                                                  \
        }                                                                                                \
        memcpy(self->NAME + r[0], values, count * sizeof(TYPE));                                         \
        return OK;                                                                                       \
    }

ACCESS(Float32, float)
ACCESS(Float64, double)
ACCESS(Int8, int8_t)
ACCESS(UInt8, uint8_t)
ACCESS(Int16, int16_t)
ACCESS(UInt16, uint16_t)
ACCESS(Int32, int32_t)
ACCESS(UInt32, uint32_t)
ACCESS(Int64, int64_t)
ACCESS(UInt64, uint64_t)
ACCESS(Boolean, uint8_t)

/* The text is all strings one after the other; each element has its end. A warning if it is empty. */
Status fmi3SetString(Instance *self, const uint32_t *r, size_t n, const char *const *values,
                     size_t count) {
    (void)r, (void)n;
    size_t length = 1;
    for (size_t i = 0; i < count; i++) {
        length += strlen(values[i]);
    }
    free(self->text);
    self->text = calloc(length, 1);
    for (size_t i = 0; i < count; i++) {
        strcat(self->text, values[i]);
    }
    return OK;
}

Status fmi3GetString(Instance *self, const uint32_t *r, size_t n, const char **values, size_t count) {
    (void)r, (void)n;
    for (size_t i = 0; i < count; i++) {
        values[i] = self->text ? self->text + i : NULL;
    }
    return self->text && !*self->text ? WARNING : OK;
}

/* By its value reference, a Binary has two bytes, none and a warning, or none although it has a size. */
Status fmi3GetBinary(Instance *self, const uint32_t *r, size_t n, size_t *sizes, const uint8_t **values,
                     size_t count) {
    static const uint8_t bytes[] = {0, 255};
    (void)self, (void)n, (void)count;
    sizes[0] = r[0] == 1 ? 0 : sizeof bytes;
    values[0] = r[0] == 0 ? bytes : NULL;
    return r[0] == 1 ? WARNING : OK;
}

/* Steps from or beyond 10 s end the simulation, those shorter than 0 fail, and those of 0 are discarded. With a
 * callback, steps from or beyond 1 s end early. */
Status fmi3DoStep(Instance *self, double time, double step, bool no_set_state, bool *event,
                  bool *terminate, bool *early, double *last) {
    *event = !no_set_state;
    *terminate = time >= 10;
    *early = false;
    *last = self->time = time + step;
    if (step <= 0) {
        self->log(self->environment, step < 0 ? ERROR : DISCARD, "logStatusError", "100% %s wrong");
        return step < 0 ? ERROR : DISCARD;
    }
    if (self->update) {
        bool requested = true;
        self->update(self->environment, time + step / 2, false, true, true, true, &requested, last);
        *early = requested || time >= 1;
        *last = self->time = *early ? time + step / 2 : time + step;
    }
    return OK;
}

Status fmi3GetFMUState(Instance *self, double **state) {
    if (!*state) {
        *state = malloc(sizeof **state);
    }
    **state = self->time;
    return OK;
}

Status fmi3SetFMUState(Instance *self, double *state) {
    self->time = *state;
    return OK;
}

Status fmi3FreeFMUState(Instance *self, double **state) {
    (void)self;
    free(*state);
    *state = NULL;
    return OK;
}

Status fmi3SerializedFMUStateSize(Instance *self, double *state, size_t *size) {
    (void)self;
    *size = sizeof *state;
    return OK;
}

Status fmi3SerializeFMUState(Instance *self, double *state, uint8_t *bytes, size_t size) {
    memcpy(bytes, state, size);
    if (self->time == 7) {
        bytes[size] = 1; /* too many */
    }
    return OK;
}

Status fmi3DeserializeFMUState(Instance *self, const uint8_t *bytes, size_t size, double **state) {
    *state = NULL;
    fmi3GetFMUState(self, state);
    memcpy(*state, bytes, size);
    return OK;
}

/* The sum of the seed times the number of values, to see which is which. */
static Status sum(size_t unknowns, size_t knowns, const double *seed, size_t n_seed, double *values,
                  size_t n_values) {
    double total = 0;
    for (size_t i = 0; i < n_seed; i++) {
        total += seed[i];
    }
    for (size_t i = 0; i < n_values; i++) {
        values[i] = total + 10 * (double)unknowns + 100 * (double)knowns;
    }
    return OK;
}

Status fmi3GetDirectionalDerivative(Instance *self, const uint32_t *u, size_t n_u, const uint32_t *k,
                                    size_t n_k, const double *seed, size_t n_seed, double *values,
                                    size_t n_values) {
    (void)self, (void)u, (void)k;
    return sum(n_u, n_k, seed, n_seed, values, n_values);
}

Status fmi3GetAdjointDerivative(Instance *self, const uint32_t *u, size_t n_u, const uint32_t *k,
                                size_t n_k, const double *seed, size_t n_seed, double *values,
                                size_t n_values) {
    (void)self, (void)u, (void)k;
    return sum(n_u, n_k, seed, n_seed, values, n_values);
}

Status fmi3GetOutputDerivatives(Instance *self, const uint32_t *r, size_t n, const int32_t *orders,
                                double *values, size_t count) {
    (void)self;
    for (size_t i = 0; i < n && i < count; i++) {
        values[i] = r[i] + 0.5 * orders[i];
    }
    return OK;
}

Status fmi3GetNumberOfContinuousStates(Instance *self, size_t *n) {
    (void)self;
    *n = 2;
    return OK;
}

Status fmi3SetTime(Instance *self, double time) {
    self->time = time;
    return OK;
}

Status fmi3SetContinuousStates(Instance *self, const double *states, size_t n) {
    memcpy(self->Float64, states, n * sizeof *states);
    return OK;
}

Status fmi3GetContinuousStateDerivatives(Instance *self, double *values, size_t n) {
    for (size_t i = 0; i < n; i++) {
        values[i] = -self->Float64[i];
    }
    return OK;
}

/* At time 1, an event at 2; later, it does not tell whether there is another one. */
Status fmi3UpdateDiscreteStates(Instance *self, bool *again, bool *terminate, bool *nominals,
                                bool *states, bool *has_next, double *next) {
    *again = *terminate = *nominals = false;
    *states = true;
    if (self->time == 1) {
        *has_next = true;
        *next = 2;
    }
    return OK;
}

Status fmi3CompletedIntegratorStep(Instance *self, bool no_set_state, bool *event, bool *terminate) {
    (void)self;
    *event = no_set_state;
    *terminate = false;
    return OK;
}
