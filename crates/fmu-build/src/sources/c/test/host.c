/* A host that calls the interface, of which the tests link two with different prefixes. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define FMI3_FUNCTION_PREFIX first_
#include "fmi3Functions.h"

/* The other FMU in the program. */
extern fmi3InstantiateCoSimulationTYPE second_fmi3InstantiateCoSimulation;
extern fmi3SetFloat64TYPE second_fmi3SetFloat64;
extern fmi3FreeInstanceTYPE second_fmi3FreeInstance;

#define CHECK(condition) \
    do { \
        if (!(condition)) { \
            fprintf(stderr, "line %d: not true: %s\n", __LINE__, #condition); \
            exit(1); \
        } \
    } while (0)

static int messages;
static fmi3Status last_status;
static char last_message[512];
static fmi3Instance stepped;

static void log_message(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category, fmi3String message)
{
    CHECK(environment == &messages && *category);
    ++messages;
    last_status = status;
    strcpy(last_message, message);
}

static void update(fmi3InstanceEnvironment environment, fmi3Float64 time, fmi3Boolean set_requested,
                   fmi3Boolean get_allowed, fmi3Boolean is_finished, fmi3Boolean can_return, fmi3Boolean *early,
                   fmi3Float64 *end)
{
    const fmi3ValueReference references[] = {0, 1};
    double values[2];
    CHECK(environment == &messages && !set_requested && get_allowed && is_finished && can_return && !*early);
    CHECK(fmi3GetFloat64(stepped, references, 2, values, 2) == fmi3OK);
    *early = true;
    *end = time + 0.25;
}

static fmi3Instance instance(void)
{
    fmi3Instance made = fmi3InstantiateCoSimulation("name", "token", "", false, false, false, false, NULL, 0, &messages,
                                                    log_message, update);
    CHECK(made);
    return made;
}

static const fmi3ValueReference all[] = {0, 1, 2, 3}, unknown[] = {7}, out_of_bounds[] = {8}, panic[] = {9};

static void values_are_passed_in_both_directions(void)
{
    const double given[] = {1.5, -2.5, 3.5, 4.5};
    const fmi3Boolean flags[] = {true, false, true};
    double *room = malloc(4 * sizeof *room);
    const char *text = "a text";
    const fmi3Byte bytes[] = {0, 255, 7}, *binary = bytes;
    size_t size = 3;
    fmi3Instance i = instance();
    CHECK(fmi3SetFloat64(i, all, 4, given, 4) == fmi3OK);
    CHECK(fmi3GetFloat64(i, all, 4, room, 4) == fmi3OK && !memcmp(room, given, sizeof given));
    CHECK(fmi3GetFloat64(i, &all[2], 1, room, 1) == fmi3OK && room[0] == 3.5);
    CHECK(fmi3SetBoolean(i, all, 3, flags, 3) == fmi3OK);
    CHECK(fmi3SetString(i, all, 1, &text, 1) == fmi3OK);
    CHECK(fmi3GetString(i, all, 1, &text, 1) == fmi3OK && !strcmp(text, "a text"));
    CHECK(fmi3SetBinary(i, all, 1, &size, &binary, 1) == fmi3OK);
    binary = NULL;
    CHECK(fmi3GetBinary(i, all, 1, &size, &binary, 1) == fmi3OK && size == 3 && !memcmp(binary, bytes, 3));
    free(room);
    fmi3FreeInstance(i);
}

static void bad_arguments_are_errors(void)
{
    double *value = malloc(sizeof *value);
    const char *text = "text";
    fmi3Instance i = instance();
    *value = 5.0;
    CHECK(fmi3SetFloat64(NULL, all, 1, value, 1) == fmi3Error && fmi3Reset(NULL) == fmi3Error);
    CHECK(fmi3SetFloat64(i, all, 0, NULL, 0) == fmi3OK && fmi3GetFloat64(i, NULL, 0, NULL, 0) == fmi3OK);
    CHECK(fmi3SetFloat64(i, NULL, 1, value, 1) == fmi3Error && fmi3SetFloat64(i, all, 1, NULL, 1) == fmi3Error);
    CHECK(fmi3SetFloat64(i, all, 1, value, 2) == fmi3Error && fmi3SetFloat64(i, all, 1, value, 300) == fmi3Error);
    CHECK(!strcmp(last_message, "bad arguments"));
    CHECK(fmi3SetFloat64(i, all, 1, value, SIZE_MAX) == fmi3Error);
    CHECK(fmi3GetFloat64(i, all, SIZE_MAX, value, 1) == fmi3Error);
    CHECK(fmi3GetFloat64(i, all, SIZE_MAX / 4 + 1, value, SIZE_MAX / 8 + 1) == fmi3Error);
    CHECK(fmi3SetFloat64(i, all, 1, value, 1000) == fmi3Error); /* more than the model has room for */
    CHECK(strstr(last_message, "fmi3SetFloat64: the arrays or strings are larger") == last_message);
    CHECK(fmi3SetString(i, all, SIZE_MAX, &text, SIZE_MAX) == fmi3Error && fmi3SetString(i, all, 1, NULL, 1) == fmi3Error);
    CHECK(fmi3GetFloat64(i, unknown, 1, value, 1) == fmi3Error && *value == 5.0);
    CHECK(fmi3ActivateModelPartition(i, 0, 0.0) == fmi3Error);
    CHECK(!fmi3InstantiateCoSimulation(NULL, "", "", 0, 0, 0, 0, NULL, 0, &messages, log_message, NULL));
    CHECK(!fmi3InstantiateCoSimulation("a", "", "", 0, 0, 0, 0, all, SIZE_MAX, &messages, log_message, NULL));
    CHECK(!fmi3InstantiateScheduledExecution("a", "", "", 0, 0, &messages, log_message, NULL, NULL, NULL));
    CHECK(fmi3GetFloat64(i, all, 1, value, 1) == fmi3OK);
    free(value);
    fmi3FreeInstance(i);
    fmi3FreeInstance(NULL);
}

static void a_host_calls_functions_within_a_step(void)
{
    fmi3Boolean event = true, terminate = true, early = false;
    double last = 0.0;
    stepped = instance();
    CHECK(fmi3DoStep(stepped, 1.0, 1.0, true, &event, &terminate, &early, &last) == fmi3OK);
    CHECK(event && !terminate && early && last == 1.25); /* the model has not set the first one */
    CHECK(fmi3DoStep(stepped, 1.0, 0.0, true, NULL, NULL, NULL, &last) == fmi3Error);
    fmi3FreeInstance(stepped);
}

/* Returns how many messages a failure caused. */
static int failure(const fmi3ValueReference *reference)
{
    double value = 5.0;
    fmi3Instance i = instance(), other = instance();
    messages = 0;
    CHECK(fmi3GetFloat64(i, reference, 1, &value, 1) == fmi3Fatal && value == 5.0);
    CHECK(last_status == fmi3Fatal && strstr(last_message, "fmi3GetFloat64: ") == last_message);
    CHECK(fmi3GetFloat64(i, all, 1, &value, 1) == fmi3Fatal && fmi3Reset(i) == fmi3Fatal);
    CHECK(fmi3GetFMUState(i, NULL) == fmi3Fatal);
    CHECK(fmi3GetFloat64(other, all, 1, &value, 1) == fmi3OK);
    fmi3FreeInstance(i);
    fmi3FreeInstance(other);
    return messages;
}

static void states_are_kept_for_the_host(int are_of_the_instance)
{
    double value = 1.0;
    fmi3FMUState states[1000] = {0}, none = &value, copy = NULL;
    fmi3Byte bytes[100];
    size_t size = 0, k;
    fmi3Instance i = instance(), other = instance();
    CHECK(fmi3SetFloat64(i, all, 1, &value, 1) == fmi3OK && fmi3GetFMUState(i, &states[0]) == fmi3OK);
    value = 2.0;
    CHECK(fmi3SetFloat64(i, all, 1, &value, 1) == fmi3OK);
    for (k = 1; k < (are_of_the_instance ? 1 : 1000); ++k)
        CHECK(fmi3GetFMUState(i, &states[k]) == fmi3OK);
    CHECK(fmi3SerializedFMUStateSize(i, states[0], &size) == fmi3OK && size == 8);
    CHECK(fmi3SerializeFMUState(i, states[0], bytes, sizeof bytes) == fmi3OK);
    CHECK(fmi3SerializeFMUState(i, states[0], bytes, 7) == fmi3Error);
    CHECK(fmi3SetFMUState(i, states[0]) == fmi3OK);
    CHECK(fmi3GetFloat64(i, all, 1, &value, 1) == fmi3OK && value == 1.0);
    CHECK(fmi3SetFMUState(other, states[0]) == (are_of_the_instance ? fmi3Error : fmi3OK));
    CHECK(fmi3DeserializeFMUState(other, bytes, 8, &copy) == fmi3OK && fmi3SetFMUState(other, copy) == fmi3OK);
    CHECK(fmi3DeserializeFMUState(other, bytes, SIZE_MAX, &copy) == fmi3Error);
    CHECK(fmi3SetFMUState(i, NULL) == fmi3Error && fmi3SetFMUState(i, none) == fmi3Error);
    CHECK(fmi3FreeFMUState(i, &none) == fmi3Error && none == &value);
    CHECK(fmi3FreeFMUState(other, &copy) == fmi3OK && !copy && fmi3FreeFMUState(other, &copy) == fmi3OK);
    for (k = 0; k < 1000; ++k)
        CHECK(fmi3FreeFMUState(i, &states[k]) == fmi3OK && !states[k]);
    fmi3FreeInstance(i);
    fmi3FreeInstance(other);
}

int main(int count, char **arguments)
{
    const int is_static = count > 1 && !strcmp(arguments[1], "static");
    const double value = 1.0;
    fmi3Instance other = second_fmi3InstantiateCoSimulation("name", "token", "", false, false, false, false, NULL, 0,
                                                            &messages, log_message, update);
    CHECK(other && second_fmi3SetFloat64(other, all, 1, &value, 1) == fmi3OK);
    values_are_passed_in_both_directions();
    bad_arguments_are_errors();
    a_host_calls_functions_within_a_step();
    CHECK(failure(out_of_bounds) == 1 && strstr(last_message, "out of bounds"));
    CHECK(failure(panic) == 1 && strstr(last_message, "src/lib.rs:1:1: the model panicked"));
    states_are_kept_for_the_host(is_static);
    second_fmi3FreeInstance(other);
    if (is_static) {
        fmi3Instance first = instance(), last = instance();
        CHECK(!fmi3InstantiateModelExchange("name", "token", "", false, false, &messages, log_message));
        CHECK(strstr(last_message, "all instances are in use"));
        fmi3FreeInstance(first);
        fmi3FreeInstance(instance());
        fmi3FreeInstance(last);
    }
    return 0;
}
