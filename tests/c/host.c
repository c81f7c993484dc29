/* A host that makes correct and incorrect calls, to be run under valgrind and on other platforms. The
 * version of FMI is chosen when it is compiled: cc -DFMI=2 or -DFMI=3.
 *
 * usage: HOST LIBRARY GUID SCENARIO [VARIABLE...]
 *
 * A VARIABLE is its type, its value reference, its number of elements if it is an array, and, if it
 * can be set, a value for it: r0=1.5 i16=2 r49*4=0.25 r1. The types are r (Real, Float64), i (Integer,
 * Enumeration), b (Boolean), n (a structural parameter, whose value is another number of elements),
 * t (String) and y (Binary), for which a value is made up, and of a model with equations: u (an input),
 * x (a state) and d (its derivative). SCENARIO is one of the names at the end.
 *
 * The exit code is 0 if the result of every call conforms to the standard; else the failed line is
 * printed. Messages of the FMU about a fatal error are printed. */
#include <math.h>
#include <stdarg.h>
#include <string.h>

#if FMI == 2
#include "fmi2.h"
#define PREFIX "fmi2"
#else
#include "fmi3.h"
#define PREFIX "fmi3"
#endif

#include "host.h"

#define DECLARE(result, name, arguments) static result(*name) arguments;
FUNCTIONS(DECLARE)

enum { MOST = 64, LONGEST = 16 };

typedef struct {
    char type;
    unsigned reference;
    size_t size;
    int settable;
    double value;
} Variable;

static const char *guid;
static Variable variables[MOST];
static size_t count;
static unsigned messages;

static const double H = 0.001;

/* --- what each version defines ---------------------------------------------------------------- */

/* Instantiates for co-simulation or model exchange. */
static Component made_for(int kind, int debug);
static void enter_initialization(Component c, double time);
static Status do_step(Component c, double time, double step);
/* Sets all elements of a variable to its value. */
static Status set(Component c, const Variable *v);
/* Returns the sum of the elements of a variable, read into memory of their exact size, so that an
 * out-of-bounds write is detected. */
static double get(Component c, const Variable *v);
/* Iterates in event mode, and returns the time of the next event. */
static double next_event(Component c);
/* Checks what only this version can tell: its name, and the status after 100 steps. */
static void check_version(Component c);
/* Passes wrong arguments to all functions, to an instance in any state or to none. */
static void bad_arguments_in(Component c);
/* Passes wrong arguments to the functions that instantiate. */
static void bad_instances(void);

/* --- calls ------------------------------------------------------------------------------------ */

static Component made(int debug)
{
    return made_for(CO_SIMULATION, debug);
}

static void initialize(Component c, double time)
{
    enter_initialization(c, time);
    EXPECT(OK, ExitInitializationMode(c));
}

static void set_all(Component c)
{
    for (size_t k = 0; k < count; ++k)
        if (variables[k].settable && variables[k].type != 'n')
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
        EXPECT(OK, do_step(c, k * H, H));
}

static Byte *serialized(Component c, State state, size_t *size)
{
    EXPECT(OK, SerializedFMUstateSize(c, state, size));
    Byte *bytes = malloc(*size);
    EXPECT(OK, SerializeFMUstate(c, state, bytes, *size));
    for (size_t k = 0; k < *size; ++k)
        CHECK(bytes[k] || 1);
    return bytes;
}

/* --- scenarios -------------------------------------------------------------------------------- */

static void life_cycle(void)
{
    Component c = made(1);
    initialize(c, 0.0);
    steps(c, 0, 100);
    check_version(c);
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
    enter_initialization(c, 0.0);
    set_all(c);
    for (size_t k = 0; k < count; ++k) {
        const Variable *v = &variables[k];
        CHECK(!v->settable || strchr("nty", v->type) || get(c, v) == v->size * v->value);
    }
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
    Byte *bytes = serialized(c, state, &size);
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
    Byte *bytes = serialized(c, state, &size);
    for (size_t length = 0; length < size; ++length) {
        Byte *part = malloc(length ? length : 1);
        memcpy(part, bytes, length);
        EXPECT(ERROR, DeSerializeFMUstate(c, part, length, &none));
        free(part);
    }
    for (size_t bit = 0; bit < 8 * size; bit += 3) {
        bytes[bit / 8] ^= (Byte)(1 << bit % 8);
        EXPECT(ERROR, DeSerializeFMUstate(c, bytes, size, &none));
        bytes[bit / 8] ^= (Byte)(1 << bit % 8);
    }
    Byte *small = malloc(size - 1);
    EXPECT(ERROR, SerializeFMUstate(c, state, small, size - 1));
    CHECK(!none);
    EXPECT(OK, DeSerializeFMUstate(c, bytes, size, &none));
    EXPECT(OK, FreeFMUstate(c, &none));
    EXPECT(OK, FreeFMUstate(c, &state));
    free(small);
    free(bytes);
    FreeInstance(c);
}

static void bad_values_in(Component c, int running)
{
    for (size_t k = 0; k < count; ++k) {
        Variable v = variables[k];
        v.value = strchr("ibn", v.type) ? -1 : NAN;
        EXPECT(ERROR, set(c, &v));
        if (!v.settable && running)
            CHECK(isfinite(get(c, &v)));
    }
}

static void bad_arguments(void)
{
    bad_instances();
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
        EXPECT(OK, do_step(one, (50 + k) * H, H));
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
    const Status status = do_step(c, 0.0, 1e300);
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
    EXPECT(FATAL, do_step(c, 0.0, H));
    EXPECT(FATAL, Reset(c));
    EXPECT(FATAL, do_step(c, 0.0, H));
    steps(other, 0, 10);
    FreeInstance(c);
    get_all(other);
    FreeInstance(other);
    c = made(0);
    initialize(c, 0.0);
    steps(c, 0, 10);
    FreeInstance(c);
}

/* Integrates by Euler's method, in communication steps from the first to the last. */
static double integrate(Component c, double event, int first, int last)
{
    size_t n = 0;
    for (size_t k = 0; k < count; ++k)
        n += variables[k].type == 'x';
    double *states = malloc(n * sizeof *states), *slopes = malloc(n * sizeof *slopes);
    for (int k = first; k < last; ++k) {
        Flag enter, terminate;
        EXPECT(OK, GetContinuousStates(c, states, n));
        EXPECT(OK, GetDerivatives(c, slopes, n));
        for (size_t i = 0; i < n; ++i)
            states[i] += H * slopes[i];
        EXPECT(OK, SetTime(c, (k + 1) * H));
        if (n)
            EXPECT(OK, SetContinuousStates(c, states, n));
        EXPECT(OK, GetEventIndicators(c, NULL, 0));
        EXPECT(OK, CompletedIntegratorStep(c, 1, &enter, &terminate));
        CHECK(!terminate);
        if (enter || (k + 1) * H > event - 1e-9) {
            EXPECT(OK, EnterEventMode(c));
            event = next_event(c);
            EXPECT(OK, EnterContinuousTimeMode(c));
        }
    }
    EXPECT(OK, GetNominalsOfContinuousStates(c, slopes, n));
    for (size_t i = 0; i < n; ++i)
        CHECK(slopes[i] > 0);
    free(states);
    free(slopes);
    return event;
}

static void exchange(void)
{
    Component c = made_for(MODEL_EXCHANGE, 0);
    State state = NULL;
    set_all(c);
    initialize(c, 0.0);
    double event = next_event(c);
    EXPECT(OK, EnterContinuousTimeMode(c));
    event = integrate(c, event, 0, 20);
    EXPECT(OK, GetFMUstate(c, &state));
    integrate(c, event, 20, 40);
    const double end = get_all(c);
    EXPECT(OK, SetFMUstate(c, state));
    integrate(c, event, 20, 40);
    CHECK(get_all(c) == end);
    EXPECT(OK, FreeFMUstate(c, &state));
    EXPECT(ERROR, do_step(c, 40 * H, H));
    EXPECT(OK, Terminate(c));
    EXPECT(OK, Reset(c));
    bad_arguments_in(c);
    initialize(c, 0.0);
    next_event(c);
    FreeInstance(c);
}

#ifdef COUNT_ALLOCATIONS

/* What the FMU calls instead of malloc, calloc and realloc. */
void *counted_malloc(size_t size);
void *counted_calloc(size_t n, size_t size);
void *counted_realloc(void *memory, size_t size);

static unsigned allocations;

void *counted_malloc(size_t size)
{
    ++allocations;
    return malloc(size);
}

void *counted_calloc(size_t n, size_t size)
{
    ++allocations;
    return calloc(n, size);
}

void *counted_realloc(void *memory, size_t size)
{
    ++allocations;
    return realloc(memory, size);
}

static void one_allocation(void)
{
    Component c = made(1);
    CHECK(allocations == 1);
    set_all(c);
    initialize(c, 0.0);
    steps(c, 0, 100);
    get_all(c);
    EXPECT(OK, Reset(c));
    CHECK(allocations == 1);
    FreeInstance(c);
}

#endif

#if FMI == 2
#include "host2.h"
#else
#include "host3.h"
#endif

/* --- main ------------------------------------------------------------------------------------- */

static const struct {
    const char *name;
    void (*run)(void);
} scenarios[] = {
    {"life_cycle", life_cycle},
    {"values", values},
    {"fmu_state", fmu_state},
    {"damaged_bytes", damaged_bytes},
    {"bad_arguments", bad_arguments},
    {"two_instances", two_instances},
    {"reset", reset},
    {"trouble", trouble},
    {"panic", panic},
    {"exchange", exchange},
#ifdef COUNT_ALLOCATIONS
    {"one_allocation", one_allocation},
#endif
#if FMI == 3
    {"events", events},
    {"derivatives", derivatives},
    {"sizes", sizes},
#endif
};

static Variable parsed(const char *text)
{
    char *rest;
    Variable v = {text[0], (unsigned)strtoul(text + 1, &rest, 10), 1, 0, 0.0};
    if (*rest == '*')
        v.size = strtoul(rest + 1, &rest, 10);
    v.settable = *rest == '=';
    if (v.settable)
        v.value = strtod(rest + 1, NULL);
    CHECK(v.size <= LONGEST);
    return v;
}

int main(int argc, char **argv)
{
    CHECK(argc >= 4 && argc - 4 <= MOST);
    void *library = load_library(argv[1]);
#define LOAD(result, name, arguments) *(void **)&name = find_function(library, PREFIX #name);
    FUNCTIONS(LOAD)
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
