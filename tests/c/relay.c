/* A small FMU for co-simulation with variables of every type and closed-form outputs:
 *
 *     time = t                count = steps taken        odd = count is odd
 *     y = gain u, or gain u^2 if shape is "square"       m = n + add
 *     c = b, or not b if invert is set                   choice = shape
 *     number = the content of the file named by `file` in the folder `resources`
 *
 * y, m and c follow their inputs immediately if `direct` is set, else in a step. Inputs are rejected
 * while u is above `u_max`. From `status_time` on, fmi2DoStep returns `status`, and logs a message
 * with the status `logged` unless that is -1. A call after fmi2Fatal ends the process.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "stubs.h"

enum { TIME, U, Y, GAIN, STATUS_TIME, NUMBER, U_MAX, REALS };
enum { COUNT, N, M, ADD, STATUS, LOGGED, SHAPE, CHOICE, INTEGERS };
enum { ODD, B, C, INVERT, DIRECT, BOOLEANS };
enum { FILE_NAME, LABEL, STRINGS };
enum { LINEAR = 1, SQUARE = 4 };

/* The GUID after decoding the XML of the model description. */
#define GUID "{relay <&> 'single' \"double\"}"

typedef struct {
    const Callbacks *callbacks;
    char name[64], resources[256];
    double reals[REALS];
    int integers[INTEGERS], booleans[BOOLEANS];
    char strings[STRINGS][64];
} Instance;

static int fatal;

static void say(const Instance *c, int status, const char *text, const char *detail) {
    c->callbacks->logger(c->callbacks->environment, c->name, status, "relay", text, detail);
}

/* Called at the start of every function. */
static void check_alive(void) {
    if (fatal) abort();
}

static void pass_on(Instance *c) {
    double *r = c->reals;
    int *i = c->integers, *b = c->booleans;
    r[Y] = r[GAIN] * r[U] * (i[SHAPE] == SQUARE ? r[U] : 1);
    i[M] = i[N] + i[ADD];
    b[C] = b[B] != b[INVERT];
}

EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORT const char *fmi2GetVersion(void) { return "2.0"; }
EXPORT int fmi2SetDebugLogging(void) { return OK; }

static void start(Instance *c) {
    memset(c->reals, 0, sizeof c->reals);
    memset(c->integers, 0, sizeof c->integers);
    memset(c->booleans, 0, sizeof c->booleans);
    memset(c->strings, 0, sizeof c->strings);
    c->reals[GAIN] = 1;
    c->reals[STATUS_TIME] = c->reals[U_MAX] = 1e300;
    c->integers[LOGGED] = -1;
    c->integers[SHAPE] = LINEAR;
}

#ifndef WITHOUT_INIT
EXPORT Instance *fmi2Instantiate(const char *name, int type, const char *guid, const char *resources,
                                 const Callbacks *callbacks) {
    (void)type;
    check_alive();
    Instance *c = calloc(1, sizeof *c);
    c->callbacks = callbacks;
    snprintf(c->name, sizeof c->name, "%s", name);
    snprintf(c->resources, sizeof c->resources, "%s", resources + strlen("file://"));
    if (strcmp(guid, GUID)) {
        say(c, ERROR, "the GUID is %s", guid);
        free(c);
        return NULL;
    }
    start(c);
    return c;
}
#endif

EXPORT void fmi2FreeInstance(Instance *c) {
    check_alive();
    free(c);
}

EXPORT int fmi2SetupExperiment(Instance *c, int tolerance_defined, double tolerance, double start) {
    (void)tolerance_defined, (void)tolerance;
    check_alive();
    c->reals[TIME] = start;
    return OK;
}

EXPORT int fmi2EnterInitializationMode(Instance *c) {
    check_alive();
    c->integers[CHOICE] = c->integers[SHAPE];
    const char *name = c->strings[FILE_NAME];
    if (!*name) return OK;
    char path[400];
    snprintf(path, sizeof path, "%s/%s", c->resources, name);
    FILE *file = fopen(path, "r");
    if (!file || fscanf(file, "%lf", &c->reals[NUMBER]) != 1) {
        say(c, ERROR, "there is no number in %s", path);
        return ERROR;
    }
    fclose(file);
    return OK;
}

EXPORT int fmi2ExitInitializationMode(Instance *c) {
    check_alive();
    return c ? OK : ERROR;
}

EXPORT int fmi2Terminate(Instance *c) {
    check_alive();
    return c ? OK : ERROR;
}

#define ACCESS(type, value, values_of, count)                                                      \
    EXPORT int fmi2Get##type(Instance *c, References references, size_t n, value *values) {        \
        check_alive();                                                                             \
        if (c->booleans[DIRECT]) pass_on(c);                                                       \
        for (size_t i = 0; i < n; i++) {                                                           \
            if (references[i] >= count) return ERROR;                                              \
            values[i] = c->values_of[references[i]];                                               \
        }                                                                                          \
        return OK;                                                                                 \
    }                                                                                              \
    EXPORT int fmi2Set##type(Instance *c, References references, size_t n, const value *values) {  \
        check_alive();                                                                             \
        for (size_t i = 0; i < n; i++) {                                                           \
            if (references[i] >= count) return ERROR;                                              \
            c->values_of[references[i]] = values[i];                                               \
        }                                                                                          \
        return c->reals[U] > c->reals[U_MAX] ? ERROR : OK;                                                                                 \
    }

ACCESS(Real, double, reals, REALS)
ACCESS(Integer, int, integers, INTEGERS)
ACCESS(Boolean, int, booleans, BOOLEANS)

EXPORT int fmi2SetString(Instance *c, References references, size_t n, const char *const *values) {
    check_alive();
    for (size_t i = 0; i < n; i++) {
        if (references[i] >= STRINGS) return ERROR;
        snprintf(c->strings[references[i]], sizeof c->strings[0], "%s", values[i]);
    }
    return OK;
}

EXPORT int fmi2GetString(Instance *c, References references, size_t n, const char **values) {
    check_alive();
    for (size_t i = 0; i < n; i++) {
        if (references[i] >= STRINGS) return ERROR;
        values[i] = c->strings[references[i]];
    }
    return OK;
}

EXPORT int fmi2Reset(Instance *c) {
    check_alive();
    start(c);
    return OK;
}

#ifndef WITHOUT_STEP
EXPORT int fmi2DoStep(Instance *c, double time, double step) {
    check_alive();
    int status = OK;
    if (time >= c->reals[STATUS_TIME]) {
        status = c->integers[STATUS];
        if (c->integers[LOGGED] >= 0) say(c, c->integers[LOGGED], "it is too hot for %s", c->name);
        fatal = status == FATAL;
        if (status != OK && status != WARNING) return status;
    }
    pass_on(c);
    c->reals[TIME] = time + step;
    c->integers[COUNT]++;
    c->booleans[ODD] = c->integers[COUNT] % 2;
    return status;
}
#endif

OPTIONAL_STUBS
