/* The FMUs of the command line of cycle.c, and the calls of FMI 2.0 and FMI 3.0 that it makes. */
#ifndef FMU_H
#define FMU_H

#include <dlfcn.h>
#include <math.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "../tests/c/fmi2.h"

/* --- the functions of FMI 3.0 ----------------------------------------------------------------- */

typedef void (*LogMessage)(void *, Status, const char *, const char *);

#define FUNCTIONS_3(F)                                                                            \
    F(Component, InstantiateCoSimulation,                                                         \
      (const char *, const char *, const char *, bool, bool, bool, bool, References, size_t,      \
       void *, LogMessage, void *))                                                               \
    F(void, FreeInstance, (Component))                                                            \
    F(Status, EnterInitializationMode, (Component, bool, double, double, bool, double))           \
    F(Status, ExitInitializationMode, (Component))                                                \
    F(Status, Terminate, (Component))                                                             \
    F(Status, SetFloat64, (Component, References, size_t, const double *, size_t))                \
    F(Status, SetInt64, (Component, References, size_t, const int64_t *, size_t))                 \
    F(Status, SetBoolean, (Component, References, size_t, const bool *, size_t))                  \
    F(Status, GetFloat64, (Component, References, size_t, double *, size_t))                      \
    F(Status, DoStep, (Component, double, double, bool, bool *, bool *, bool *, double *))

/* --- the FMUs of the command line ------------------------------------------------------------- */

enum { MAX_REFERENCES = 64, MAX_FMUS = 64 };

typedef struct {
    unsigned reference;
    double value;     /* NAN: the signal, or the source's period; of an output: its elements */
    const char *from; /* the source, NAME.I, or NULL */
} Assignment;

typedef struct {
    Assignment items[MAX_REFERENCES];
    size_t n;
} Assignments;

typedef struct {
    const char *name, *binary, *guid, *resources;
    int fmi; /* 2 or 3 */
    Assignments in, out, reals, integers, booleans;
    size_t n_outputs; /* elements of all outputs */
    double *times;    /* ns, one per repeat */
    double last;      /* the first output after the last cycle, so that results can be compared */
#define MEMBER(type, name, arguments) type(*name) arguments;
    struct {
        FUNCTIONS(MEMBER)
    } fmi2;
    struct {
        FUNCTIONS_3(MEMBER)
    } fmi3;
} Fmu;

static void fail(const char *who, const char *what) {
    fprintf(stderr, "cycle: %s: %s\n", who, what);
    exit(1);
}

static void load(Fmu *fmu) {
    void *library = dlopen(fmu->binary, RTLD_NOW | RTLD_LOCAL);
    if (!library) fail(fmu->name, dlerror());
#define BIND(version, function)                                                                   \
    *(void **)&fmu->version.function = dlsym(library, #version #function);
#define BIND_2(type, function, arguments) BIND(fmi2, function)
#define BIND_3(type, function, arguments) BIND(fmi3, function)
    if (fmu->fmi == 3) {
        FUNCTIONS_3(BIND_3)
    } else {
        FUNCTIONS(BIND_2)
    }
    /* Those of model exchange, which are not called, may be missing */
    if (!(fmu->fmi == 3 ? (void *)fmu->fmi3.DoStep : (void *)fmu->fmi2.DoStep))
        fail(fmu->name, "the functions of co-simulation are missing");
}

static void append(Fmu *fmu, Assignments *list, const char *text, bool needs_value) {
    if (list->n == MAX_REFERENCES) fail(fmu->name, "too many variables");
    char *end;
    Assignment item = {.reference = (unsigned)strtoul(text, &end, 10), .value = NAN};
    if (*end == ':') {
        const char *rest = end + 1;
        item.value = strtod(rest, &end);
        if (end == rest && !needs_value) item = (Assignment){item.reference, NAN, rest};
    }
    if (end == text || (*end && !item.from) || (needs_value && isnan(item.value)))
        fail(text, "not a variable");
    list->items[list->n++] = item;
}

static void append_output(Fmu *fmu, const char *text) {
    append(fmu, &fmu->out, text, false);
    double elements = fmu->out.items[fmu->out.n - 1].value;
    if (isnan(elements)) elements = 1;
    if (!(elements >= 1) || fmu->n_outputs + elements > MAX_REFERENCES)
        fail(text, "not an output, or too many elements");
    fmu->n_outputs += (size_t)elements;
}

static void option(Fmu *fmu, const char *word) {
    const char *value = strchr(word, '=');
    if (!value) fail(word, "expected KEY=VALUE");
    size_t length = (size_t)(value++ - word);
#define IS(key) (length == strlen(key) && !strncmp(word, key, length))
    if (IS("name")) fmu->name = value;
    else if (IS("fmi") && (!strcmp(value, "2") || !strcmp(value, "3"))) fmu->fmi = *value - '0';
    else if (IS("binary")) fmu->binary = value;
    else if (IS("guid")) fmu->guid = value;
    else if (IS("resources")) fmu->resources = value;
    else if (IS("in")) append(fmu, &fmu->in, value, false);
    else if (IS("out")) append_output(fmu, value);
    else if (IS("real")) append(fmu, &fmu->reals, value, true);
    else if (IS("integer")) append(fmu, &fmu->integers, value, true);
    else if (IS("boolean")) append(fmu, &fmu->booleans, value, true);
    else fail(word, "unknown key or value");
}

/* --- an instance ------------------------------------------------------------------------------ */

/* The step (s), and the time at the start, as in the loops of the paper. */
static const double TS = 0.001;

static void logger(void *environment, const char *instance, Status status, const char *category,
                   const char *format, ...) {
    (void)environment;
    if (status == OK || status == WARNING) return;
    va_list arguments;
    va_start(arguments, format);
    fprintf(stderr, "%s: [%s] ", instance, category);
    vfprintf(stderr, format, arguments);
    fputc('\n', stderr);
    va_end(arguments);
    exit(1);
}

static void log_message(void *name, Status status, const char *category, const char *message) {
    logger(NULL, name, status, category, "%s", message);
}

static const Callbacks CALLBACKS = {logger, calloc, free, NULL, NULL};

static void must(const Fmu *fmu, Status status, const char *call) {
    if (status != OK && status != WARNING) fail(fmu->name, call);
}

static Component instantiate(const Fmu *fmu) {
    Component c;
    if (fmu->fmi == 3)
        c = fmu->fmi3.InstantiateCoSimulation(fmu->name, fmu->guid, fmu->resources, false, false,
                                              false, false, NULL, 0, (void *)fmu->name,
                                              log_message, NULL);
    else
        c = fmu->fmi2.Instantiate(fmu->name, CO_SIMULATION, fmu->guid,
                                  fmu->resources ? fmu->resources : "", &CALLBACKS, 0, 0);
    if (!c) fail(fmu->name, "cannot be instantiated");
    return c;
}

static Status set_real(const Fmu *fmu, Component c, Assignment item) {
    if (fmu->fmi == 3) return fmu->fmi3.SetFloat64(c, &item.reference, 1, &item.value, 1);
    return fmu->fmi2.SetReal(c, &item.reference, 1, &item.value);
}

static Status set_integer(const Fmu *fmu, Component c, Assignment item) {
    int value = (int)item.value;
    int64_t long_value = value;
    if (fmu->fmi == 3) return fmu->fmi3.SetInt64(c, &item.reference, 1, &long_value, 1);
    return fmu->fmi2.SetInteger(c, &item.reference, 1, &value);
}

static Status set_boolean(const Fmu *fmu, Component c, Assignment item) {
    bool value = item.value != 0;
    int int_value = value;
    if (fmu->fmi == 3) return fmu->fmi3.SetBoolean(c, &item.reference, 1, &value, 1);
    return fmu->fmi2.SetBoolean(c, &item.reference, 1, &int_value);
}

static Status enter_initialization(const Fmu *fmu, Component c) {
    if (fmu->fmi == 3) return fmu->fmi3.EnterInitializationMode(c, false, 0, TS, false, 0);
    Status status = fmu->fmi2.SetupExperiment(c, 0, 0, TS, 0, 0);
    return status > WARNING ? status : fmu->fmi2.EnterInitializationMode(c);
}

static void initialize(const Fmu *fmu, Component c) {
    for (size_t i = 0; i < fmu->reals.n; i++)
        must(fmu, set_real(fmu, c, fmu->reals.items[i]), "a real parameter");
    for (size_t i = 0; i < fmu->integers.n; i++)
        must(fmu, set_integer(fmu, c, fmu->integers.items[i]), "an integer parameter");
    for (size_t i = 0; i < fmu->booleans.n; i++)
        must(fmu, set_boolean(fmu, c, fmu->booleans.items[i]), "a Boolean parameter");
    must(fmu, enter_initialization(fmu, c), "entering initialization mode");
    must(fmu,
         fmu->fmi == 3 ? fmu->fmi3.ExitInitializationMode(c) : fmu->fmi2.ExitInitializationMode(c),
         "exiting initialization mode");
}

static void release(const Fmu *fmu, Component c) {
    if (fmu->fmi == 3) fmu->fmi3.FreeInstance(c);
    else fmu->fmi2.FreeInstance(c);
}

static void end(const Fmu *fmu, Component c) {
    must(fmu, fmu->fmi == 3 ? fmu->fmi3.Terminate(c) : fmu->fmi2.Terminate(c), "terminating");
    release(fmu, c);
}

/* --- the calls of a cycle --------------------------------------------------------------------- */

/* With the version as a constant argument, so that a cycle does not branch on it. */
#define INLINE static inline __attribute__((always_inline))

INLINE Status set_inputs(int fmi, const Fmu *fmu, Component c, References in, const double *from) {
    size_t n = fmu->in.n;
    if (fmi == 3) return fmu->fmi3.SetFloat64(c, in, n, from, n);
    return fmu->fmi2.SetReal(c, in, n, from);
}

INLINE Status get_outputs(int fmi, const Fmu *fmu, Component c, References out, double *to) {
    size_t n = fmu->out.n;
    if (fmi == 3) return fmu->fmi3.GetFloat64(c, out, n, to, fmu->n_outputs);
    return fmu->fmi2.GetReal(c, out, n, to);
}

/* A step of FMI 3.0 that ends early is an error here. */
INLINE Status step(int fmi, const Fmu *fmu, Component c, double time) {
    if (fmi == 2) return fmu->fmi2.DoStep(c, time, TS, 1);
    bool event = false, terminate = false, early = false;
    double last;
    Status status = fmu->fmi3.DoStep(c, time, TS, true, &event, &terminate, &early, &last);
    return terminate || early ? ERROR : status;
}

#endif
