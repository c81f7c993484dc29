/* A host of FMI 2.0 that makes correct and incorrect calls, to be run under valgrind and on other
 * platforms. Its usage is in scenarios.h. */

#include <stdarg.h>

#include "fmi2.h"

#define DECLARE(result, name, arguments) static result(*name) arguments;
FUNCTIONS(DECLARE)
EXCHANGE_FUNCTIONS(DECLARE)

#include "scenarios.h"

/* --- the host --------------------------------------------------------------------------------- */

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

static Component made_for(int kind, int debug)
{
    Component c = Instantiate("host", kind, guid, "file:///", &callbacks, 0, debug);
    CHECK(c);
    return c;
}

static Component made(int debug)
{
    return made_for(CO_SIMULATION, debug);
}

static void enter_initialization(Component c, double time)
{
    EXPECT(OK, SetupExperiment(c, 0, 0.0, time, 0, 0.0));
    EXPECT(OK, EnterInitializationMode(c));
}

static Status do_step(Component c, double time, double step)
{
    return DoStep(c, time, step, 1);
}

static Status set(Component c, const Variable *v)
{
    const int is_real = strchr("ruxd", v->type) != NULL;
    const int number = is_real ? 0 : (int)v->value; /* NaN cannot be converted */
    if (is_real)
        return SetReal(c, &v->reference, 1, &v->value);
    if (v->type == 'i')
        return SetInteger(c, &v->reference, 1, &number);
    return SetBoolean(c, &v->reference, 1, &number);
}

static double get(Component c, const Variable *v)
{
    double *real = malloc(sizeof *real), result;
    int *number = malloc(sizeof *number);
    if (strchr("ruxd", v->type)) {
        EXPECT(OK, GetReal(c, &v->reference, 1, real));
        result = *real;
    } else {
        EXPECT(OK, v->type == 'i' ? GetInteger(c, &v->reference, 1, number)
                                  : GetBoolean(c, &v->reference, 1, number));
        result = *number;
    }
    free(real);
    free(number);
    return result;
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
    EXPECT(ERROR, DoStep(c, NAN, H, 1));
    EXPECT(ERROR, DoStep(c, 0.0, INFINITY, 1));
    EXPECT(ERROR, DoStep(c, 7.0, H, 1));
    EXPECT(ERROR, EnterEventMode(c));
    EXPECT(ERROR, NewDiscreteStates(c, NULL));
    EXPECT(ERROR, EnterContinuousTimeMode(c));
    EXPECT(ERROR, CompletedIntegratorStep(c, 1, NULL, NULL));
    EXPECT(ERROR, SetTime(c, NAN));
    EXPECT(ERROR, SetContinuousStates(c, &real, 1));
    EXPECT(ERROR, GetDerivatives(c, NULL, 1));
    EXPECT(ERROR, GetEventIndicators(c, NULL, 1));
    EXPECT(ERROR, GetContinuousStates(c, NULL, 1));
    EXPECT(ERROR, GetNominalsOfContinuousStates(c, NULL, 1));
}

static void bad_arguments(void)
{
    CHECK(!Instantiate("host", CO_SIMULATION, "{no guid}", NULL, &callbacks, 0, 1));
    CHECK(!Instantiate("host", 2, guid, NULL, &callbacks, 0, 1)); /* no type of FMU */
    CHECK(!Instantiate(NULL, CO_SIMULATION, guid, NULL, &callbacks, 0, 1));
    CHECK(!Instantiate("\xff", CO_SIMULATION, guid, NULL, &callbacks, 0, 1));
    CHECK(!Instantiate("host", CO_SIMULATION, NULL, NULL, NULL, 0, 1));
    bad_calls();
}

/* Iterates in event mode, and returns the time of the next event. */
static double next_event(Component c)
{
    Event event;
    do
        EXPECT(OK, NewDiscreteStates(c, &event));
    while (event.discrete_states_need_update);
    CHECK(!event.terminate);
    EXPECT(OK, EnterContinuousTimeMode(c));
    return event.next_event_time_defined ? event.next_event_time : INFINITY;
}

/* Integrates by Euler's method, in communication steps from the first to the last. */
static double integrate(Component c, double event, int first, int last)
{
    size_t n = 0;
    for (size_t k = 0; k < count; ++k)
        n += variables[k].type == 'x';
    double *states = malloc(n * sizeof *states), *slopes = malloc(n * sizeof *slopes);
    for (int k = first; k < last; ++k) {
        int enter, terminate;
        EXPECT(OK, GetContinuousStates(c, states, n));
        EXPECT(OK, GetDerivatives(c, slopes, n));
        for (size_t i = 0; i < n; ++i)
            states[i] += H * slopes[i];
        EXPECT(OK, SetTime(c, (k + 1) * H));
        EXPECT(OK, SetContinuousStates(c, states, n));
        EXPECT(OK, GetEventIndicators(c, NULL, 0));
        EXPECT(OK, CompletedIntegratorStep(c, 1, &enter, &terminate));
        CHECK(!terminate);
        if (enter || (k + 1) * H > event - 1e-9) {
            EXPECT(OK, EnterEventMode(c));
            event = next_event(c);
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
    double event = integrate(c, next_event(c), 0, 20);
    EXPECT(OK, GetFMUstate(c, &state));
    integrate(c, event, 20, 40);
    const double end = get_all(c);
    EXPECT(OK, SetFMUstate(c, state));
    integrate(c, event, 20, 40);
    CHECK(get_all(c) == end);
    EXPECT(OK, FreeFMUstate(c, &state));
    EXPECT(ERROR, DoStep(c, 40 * H, H, 1));
    EXPECT(OK, Terminate(c));
    EXPECT(OK, Reset(c));
    bad_arguments_in(c);
    initialize(c, 0.0);
    next_event(c);
    FreeInstance(c);
}

/* --- main ------------------------------------------------------------------------------------- */

static const Scenario scenarios[] = {
    COMMON,
    {"life_cycle", life_cycle},
    {"bad_arguments", bad_arguments},
    {"exchange", exchange},
    {"panic", panic},
};

int main(int argc, char **argv)
{
    void *library = load_library(argc > 1 ? argv[1] : "");
#define LOAD(result, name, arguments) *(void **)&name = find_function(library, "fmi2" #name);
    FUNCTIONS(LOAD)
    EXCHANGE_FUNCTIONS(LOAD)
    run(argc, argv, scenarios, sizeof scenarios / sizeof *scenarios);
    unload_library(library);
    return 0;
}
