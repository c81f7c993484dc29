/* A host of FMI 2.0 co-simulation FMUs that makes correct and incorrect calls, to be run under
 * valgrind and on other platforms.
 *
 * usage: host LIBRARY GUID SCENARIO [VARIABLE...]
 *
 * A VARIABLE is its type (r, i, b), its value reference, and, if it can be set, a value for it:
 * r0=1.5 i16=2 r1. SCENARIO is one of the names at the end of this file.
 *
 * The exit code is 0 if the result of every call conforms to the standard; else the failed line is
 * printed. Messages of the FMU about a fatal error are printed. */

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "host.h"

#define DECLARE(result, name, arguments) static result(*name) arguments;
FUNCTIONS(DECLARE)
DECLARE(Status, EnterEventMode, (Component))

/* --- the host --------------------------------------------------------------------------------- */

enum { MOST = 64 };

typedef struct {
    char type;
    unsigned reference;
    int settable;
    double value;
} Variable;

static const char *guid;
static Variable variables[MOST];
static size_t count;
static unsigned messages;

static const double H = 0.001;

/* Formats every message, so that all its bytes are read. */
static void logger(void *environment, const char *instance, Status status, const char *category,
                   const char *format, ...)
{
    static char text[1 << 16];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    CHECK(environment == &messages && status <= FATAL);
    CHECK(strlen(instance) + strlen(category) + strlen(text) > 0);
    if (status == FATAL)
        printf("[%s] %s\n", category, text);
    ++messages;
}

static const Callbacks callbacks = {logger, NULL, NULL, NULL, &messages};

static Component made(int debug)
{
    Component c = Instantiate("host", CO_SIMULATION, guid, "file:///", &callbacks, 0, debug);
    CHECK(c);
    return c;
}

static void initialize(Component c, double time)
{
    EXPECT(OK, SetupExperiment(c, 0, 0.0, time, 0, 0.0));
    EXPECT(OK, EnterInitializationMode(c));
    EXPECT(OK, ExitInitializationMode(c));
}

static Status set(Component c, const Variable *v)
{
    const int number = v->type == 'r' ? 0 : (int)v->value; /* NaN cannot be converted */
    switch (v->type) {
    case 'r': return SetReal(c, &v->reference, 1, &v->value);
    case 'i': return SetInteger(c, &v->reference, 1, &number);
    default: return SetBoolean(c, &v->reference, 1, &number);
    }
}

/* Reads into separately allocated memory, so that an out-of-bounds write is detected. */
static double get(Component c, const Variable *v)
{
    double *real = malloc(sizeof *real), result;
    int *number = malloc(sizeof *number);
    switch (v->type) {
    case 'r': EXPECT(OK, GetReal(c, &v->reference, 1, real)); result = *real; break;
    case 'i': EXPECT(OK, GetInteger(c, &v->reference, 1, number)); result = *number; break;
    default: EXPECT(OK, GetBoolean(c, &v->reference, 1, number)); result = *number;
    }
    free(real);
    free(number);
    return result;
}

static void set_all(Component c)
{
    for (size_t k = 0; k < count; ++k)
        if (variables[k].settable)
            EXPECT(OK, set(c, &variables[k]));
}

/* The sum of all values: branching on it lets valgrind check that all are initialized. */
static double get_all(Component c)
{
    double sum = 0;
    for (size_t k = 0; k < count; ++k)
        sum += get(c, &variables[k]);
    CHECK(isfinite(sum));
    return sum;
}

static void steps(Component c, int first, int last)
{
    for (int k = first; k < last; ++k)
        EXPECT(OK, DoStep(c, k * H, H, 1));
}

static char *serialized(Component c, State state, size_t *size)
{
    EXPECT(OK, SerializedFMUstateSize(c, state, size));
    char *bytes = malloc(*size);
    EXPECT(OK, SerializeFMUstate(c, state, bytes, *size));
    for (size_t k = 0; k < *size; ++k)
        CHECK(bytes[k] || 1);
    return bytes;
}

/* --- scenarios -------------------------------------------------------------------------------- */

static void life_cycle(void)
{
    CHECK(!strcmp(GetVersion(), "2.0") && !strcmp(GetTypesPlatform(), "default"));
    Component c = made(1);
    initialize(c, 0.0);
    steps(c, 0, 100);
    double time;
    int ended;
    EXPECT(OK, GetRealStatus(c, LAST_SUCCESSFUL_TIME, &time));
    EXPECT(OK, GetBooleanStatus(c, TERMINATED, &ended));
    CHECK(fabs(time - 100 * H) < 1e-9 && !ended);
    EXPECT(OK, Terminate(c));
    FreeInstance(c);
    FreeInstance(made(0));
    FreeInstance(NULL);
    CHECK(messages > 0);
}

static void values(void)
{
    Component c = made(0);
    set_all(c);
    EXPECT(OK, SetupExperiment(c, 0, 0.0, 0.0, 0, 0.0));
    EXPECT(OK, EnterInitializationMode(c));
    set_all(c);
    for (size_t k = 0; k < count; ++k)
        CHECK(!variables[k].settable || get(c, &variables[k]) == variables[k].value);
    EXPECT(OK, ExitInitializationMode(c));
    steps(c, 0, 100);
    get_all(c);
    FreeInstance(c);
    CHECK(messages == 0);
}

static void fmu_state(void)
{
    Component c = made(0), other = made(0);
    State state = NULL, copy = NULL;
    size_t size;
    set_all(c);
    initialize(c, 0.0);
    steps(c, 0, 20);
    EXPECT(OK, GetFMUstate(c, &state));
    char *bytes = serialized(c, state, &size);
    steps(c, 20, 40);
    const double end = get_all(c);
    EXPECT(OK, DeSerializeFMUstate(other, bytes, size, &copy));
    EXPECT(OK, SetFMUstate(other, copy));
    steps(other, 20, 40);
    CHECK(get_all(other) == end);
    EXPECT(OK, SetFMUstate(c, state));
    EXPECT(OK, GetFMUstate(c, &state));
    EXPECT(OK, FreeFMUstate(other, &copy));
    CHECK(!copy);
    EXPECT(OK, FreeFMUstate(other, &copy));
    FreeInstance(c);
    EXPECT(OK, SetFMUstate(other, state));
    EXPECT(OK, FreeFMUstate(other, &state));
    FreeInstance(other);
    free(bytes);
}

/* Each damaged copy is allocated with its exact length, so that an out-of-bounds read is detected. */
static void damaged_bytes(void)
{
    Component c = made(1);
    State state = NULL, none = NULL;
    size_t size;
    EXPECT(OK, GetFMUstate(c, &state));
    char *bytes = serialized(c, state, &size);
    for (size_t length = 0; length < size; ++length) {
        char *part = malloc(length ? length : 1);
        memcpy(part, bytes, length);
        EXPECT(ERROR, DeSerializeFMUstate(c, part, length, &none));
        free(part);
    }
    for (size_t bit = 0; bit < 8 * size; bit += 3) {
        bytes[bit / 8] ^= (char)(1 << bit % 8);
        EXPECT(ERROR, DeSerializeFMUstate(c, bytes, size, &none));
        bytes[bit / 8] ^= (char)(1 << bit % 8);
    }
    char *small = malloc(size - 1);
    EXPECT(ERROR, SerializeFMUstate(c, state, small, size - 1));
    CHECK(!none);
    EXPECT(OK, DeSerializeFMUstate(c, bytes, size, &none));
    EXPECT(OK, FreeFMUstate(c, &none));
    EXPECT(OK, FreeFMUstate(c, &state));
    free(small);
    free(bytes);
    FreeInstance(c);
}

static void bad_arguments_in(Component c)
{
    const unsigned unknown = 4000000000u;
    const char *text = "%s%n", *bad[] = {"%s%n", "\xff\xfe", NULL};
    double real = NAN;
    int number = 7;
    State none = NULL;
    EXPECT(ERROR, GetReal(c, &unknown, 1, &real));
    EXPECT(ERROR, GetInteger(c, &unknown, 1, &number));
    EXPECT(ERROR, GetBoolean(c, NULL, 1, &number));
    EXPECT(ERROR, GetString(c, &unknown, 1, &text));
    EXPECT(ERROR, SetReal(c, &unknown, 1, &real));
    EXPECT(ERROR, SetInteger(c, &unknown, 1, NULL));
    EXPECT(ERROR, SetBoolean(c, &unknown, 1, &number));
    EXPECT(ERROR, SetString(c, &unknown, 1, &text));
    EXPECT(ERROR, SetupExperiment(c, 0, 0.0, NAN, 0, 0.0));
    EXPECT(ERROR, SetDebugLogging(c, 1, 1, bad));
    EXPECT(ERROR, SetDebugLogging(c, 1, 3, bad));
    EXPECT(ERROR, SetDebugLogging(c, 1, 1, NULL));
    EXPECT(ERROR, GetFMUstate(c, NULL));
    EXPECT(ERROR, SetFMUstate(c, NULL));
    EXPECT(ERROR, SerializeFMUstate(c, NULL, NULL, 0));
    EXPECT(ERROR, DeSerializeFMUstate(c, NULL, 10, &none));
    EXPECT(ERROR, GetDirectionalDerivative(c, &unknown, 1, &unknown, 1, &real, &real));
    EXPECT(ERROR, SetRealInputDerivatives(c, &unknown, 1, &number, &real));
    EXPECT(ERROR, GetRealOutputDerivatives(c, &unknown, 1, &number, &real));
    EXPECT(ERROR, GetStringStatus(c, 1, &text));
    EXPECT(ERROR, CancelStep(c));
    EXPECT(ERROR, EnterEventMode(c));
    EXPECT(ERROR, DoStep(c, NAN, H, 1));
    EXPECT(ERROR, DoStep(c, 0.0, INFINITY, 1));
    EXPECT(ERROR, DoStep(c, 7.0, H, 1));
}

static void bad_values_in(Component c, int running)
{
    for (size_t k = 0; k < count; ++k) {
        Variable v = variables[k];
        v.value = v.type == 'r' ? NAN : -1;
        EXPECT(ERROR, set(c, &v));
        if (!v.settable && running)
            CHECK(isfinite(get(c, &v)));
    }
}

static void bad_arguments(void)
{
    CHECK(!Instantiate("host", CO_SIMULATION, "{no guid}", NULL, &callbacks, 0, 1));
    CHECK(!Instantiate("host", 2, guid, NULL, &callbacks, 0, 1)); /* no type of FMU */
    CHECK(!Instantiate(NULL, CO_SIMULATION, guid, NULL, &callbacks, 0, 1));
    CHECK(!Instantiate("\xff", CO_SIMULATION, guid, NULL, &callbacks, 0, 1));
    CHECK(!Instantiate("host", CO_SIMULATION, NULL, NULL, NULL, 0, 1));
    bad_arguments_in(NULL);
    Component c = made(1);
    bad_arguments_in(c);
    bad_values_in(c, 0);
    initialize(c, 0.0);
    bad_arguments_in(c);
    bad_values_in(c, 1);
    steps(c, 0, 3);
    EXPECT(OK, Terminate(c));
    bad_arguments_in(c);
    FreeInstance(c);
}

static void two_instances(void)
{
    Component one = made(0), two = made(0);
    set_all(one);
    initialize(one, 0.0);
    initialize(two, 0.0);
    steps(one, 0, 50);
    const double alone = get_all(one);
    for (int k = 0; k < 50; ++k) {
        steps(two, k, k + 1);
        EXPECT(OK, DoStep(one, (50 + k) * H, H, 1));
    }
    EXPECT(OK, Reset(one));
    set_all(one);
    initialize(one, 0.0);
    FreeInstance(two);
    steps(one, 0, 50);
    CHECK(get_all(one) == alone);
    FreeInstance(one);
}

static void reset(void)
{
    Component c = made(0);
    EXPECT(OK, Reset(c));
    double first = 0;
    for (int round = 0; round < 20; ++round) {
        set_all(c);
        initialize(c, 0.0);
        steps(c, 0, 10);
        first = round ? first : get_all(c);
        CHECK(get_all(c) == first);
        EXPECT(OK, Reset(c));
    }
    FreeInstance(c);
}

/* A step that overflows or takes too long, and the state of the instance after it. */
static void trouble(void)
{
    Component c = made(1);
    set_all(c);
    initialize(c, 0.0);
    const Status status = DoStep(c, 0.0, 1e300, 1);
    CHECK(status == OK || status == DISCARD || status == ERROR);
    EXPECT(OK, Reset(c));
    initialize(c, 0.0);
    steps(c, 0, 10);
    get_all(c);
    FreeInstance(c);
}

/* The start values of the variables make the model panic in its first step. */
static void panic(void)
{
    Component c = made(0), other = made(0);
    set_all(c);
    initialize(c, 0.0);
    initialize(other, 0.0);
    EXPECT(FATAL, DoStep(c, 0.0, H, 1));
    EXPECT(FATAL, Reset(c));
    EXPECT(FATAL, DoStep(c, 0.0, H, 1));
    steps(other, 0, 10);
    FreeInstance(c);
    get_all(other);
    FreeInstance(other);
    c = made(0);
    initialize(c, 0.0);
    steps(c, 0, 10);
    FreeInstance(c);
}

static const struct {
    const char *name;
    void (*run)(void);
} scenarios[] = {
    {"life_cycle", life_cycle},       {"values", values},
    {"fmu_state", fmu_state},         {"damaged_bytes", damaged_bytes},
    {"bad_arguments", bad_arguments}, {"two_instances", two_instances},
    {"reset", reset},                 {"trouble", trouble},
    {"panic", panic},
};

/* --- main ------------------------------------------------------------------------------------- */

static void *loaded(const char *path)
{
    void *library = load_library(path);
#define LOAD(result, name, arguments) *(void **)&name = find_function(library, "fmi2" #name);
    FUNCTIONS(LOAD)
    LOAD(Status, EnterEventMode, (Component))
    return library;
}

static Variable parsed(const char *text)
{
    char *rest;
    Variable v = {text[0], (unsigned)strtoul(text + 1, &rest, 10), *rest == '=', 0.0};
    if (v.settable)
        v.value = strtod(rest + 1, NULL);
    return v;
}

int main(int argc, char **argv)
{
    CHECK(argc >= 4 && argc - 4 <= MOST);
    void *library = loaded(argv[1]);
    guid = argv[2];
    for (int k = 4; k < argc; ++k)
        variables[count++] = parsed(argv[k]);
    int found = 0;
    for (size_t k = 0; k < sizeof scenarios / sizeof *scenarios; ++k)
        if (!strcmp(argv[3], scenarios[k].name)) {
            scenarios[k].run();
            found = 1;
        }
    CHECK(found);
    unload_library(library);
    return 0;
}
