/* Couples co-simulation FMUs in sequential order, like the FMPy master, on any platform. The version of
 * FMI is chosen when it is compiled: cc -DFMI=2 or -DFMI=3.
 *
 * usage: LOOP FILE STEPS COMPONENT... with the times 0.001 s, 0.002 s, ...
 *
 * A COMPONENT is `LIBRARY GUID KIND WORD... .`, where KIND is `sampled` for one whose outputs after
 * a step belong to the beginning of the step, else `continuous`, and a WORD is one of
 *
 *     r3=0.5 i1=2 b4=1   a start value, by type and value reference
 *     r5*2=0.5,0.25      the start value of an array, with all its elements
 *     r0<2.1             a Real input, and the component (from 0) and Real output that feed it
 *     r7 r8*4            a Real output that is recorded, or all elements of an array
 *     >LIBRARY           the library of the second half, another binary of the same FMU
 *
 * FILE receives a row of doubles for every communication point. Halfway through, every component is
 * replaced by a new instance, which continues from the bytes of its state. */

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#if FMI == 2
#include "fmi2.h"
#define PREFIX "fmi2"
#else
#include "fmi3.h"
#define PREFIX "fmi3"
#endif

#include "host.h"

enum { MOST = 64 };

typedef struct {
    unsigned input, output;
    size_t component;
} Link;

typedef struct {
    const char *guid, *second_half;
    int sampled;
    Link links[MOST];
    unsigned outputs[MOST];
    size_t n_links, n_outputs, n_elements;
    double row[MOST];
    void *library;
    Component instance;
#define MEMBER(result, name, arguments) result(*name) arguments;
    FUNCTIONS(MEMBER)
} Fmu;

static Fmu fmus[MOST];
static size_t n_fmus;

static const double TS = 0.001;

/* --- what each version defines ---------------------------------------------------------------- */

#if FMI == 2

static void logger(void *environment, const char *instance, Status status, const char *category,
                   const char *format, ...) {
    (void)environment, (void)status;
    va_list arguments;
    va_start(arguments, format);
    fprintf(stderr, "%s: [%s] ", instance, category);
    vfprintf(stderr, format, arguments);
    fputc('\n', stderr);
    va_end(arguments);
}

static const Callbacks callbacks = {logger, NULL, NULL, NULL, NULL};

static Component instantiate(const Fmu *fmu) {
    Component c = fmu->Instantiate("loop", CO_SIMULATION, fmu->guid, NULL, &callbacks, 0, 0);
    CHECK(c);
    return c;
}

static void start(const Fmu *fmu, char type, unsigned reference, const double *values, size_t n) {
    const int number = type == 'r' ? 0 : (int)*values;
    CHECK(n == 1);
    switch (type) {
    case 'r': EXPECT(OK, fmu->SetReal(fmu->instance, &reference, 1, values)); break;
    case 'i': EXPECT(OK, fmu->SetInteger(fmu->instance, &reference, 1, &number)); break;
    default: EXPECT(OK, fmu->SetBoolean(fmu->instance, &reference, 1, &number));
    }
}

static void enter_initialization(const Fmu *fmu) {
    EXPECT(OK, fmu->SetupExperiment(fmu->instance, 0, 0, TS, 0, 0));
    EXPECT(OK, fmu->EnterInitializationMode(fmu->instance));
}

static void get(const Fmu *fmu, const unsigned *outputs, size_t n, double *values, size_t n_values) {
    CHECK(n_values == n);
    EXPECT(OK, fmu->GetReal(fmu->instance, outputs, n, values));
}

static void set(const Fmu *fmu, unsigned input, double value) {
    EXPECT(OK, fmu->SetReal(fmu->instance, &input, 1, &value));
}

static void do_step(const Fmu *fmu, double time) {
    EXPECT(OK, fmu->DoStep(fmu->instance, time, TS, 1));
}

#else

static void logger(void *environment, Status status, const char *category, const char *message) {
    (void)environment, (void)status;
    fprintf(stderr, "[%s] %s\n", category, message);
}

static Component instantiate(const Fmu *fmu) {
    Component c = fmu->InstantiateCoSimulation("loop", fmu->guid, NULL, false, false, false, false, NULL,
                                               0, NULL, logger, NULL);
    CHECK(c);
    return c;
}

static void start(const Fmu *fmu, char type, unsigned reference, const double *values, size_t n) {
    const int64_t number = type == 'r' ? 0 : (int64_t)*values;
    const bool flag = number;
    CHECK(type == 'r' || n == 1);
    switch (type) {
    case 'r': EXPECT(OK, fmu->SetFloat64(fmu->instance, &reference, 1, values, n)); break;
    case 'i': EXPECT(OK, fmu->SetInt64(fmu->instance, &reference, 1, &number, 1)); break;
    default: EXPECT(OK, fmu->SetBoolean(fmu->instance, &reference, 1, &flag, 1));
    }
}

static void enter_initialization(const Fmu *fmu) {
    EXPECT(OK, fmu->EnterInitializationMode(fmu->instance, false, 0, TS, false, 0));
}

static void get(const Fmu *fmu, const unsigned *outputs, size_t n, double *values, size_t n_values) {
    EXPECT(OK, fmu->GetFloat64(fmu->instance, outputs, n, values, n_values));
}

static void set(const Fmu *fmu, unsigned input, double value) {
    EXPECT(OK, fmu->SetFloat64(fmu->instance, &input, 1, &value, 1));
}

static void do_step(const Fmu *fmu, double time) {
    bool event, terminate, early;
    double reached;
    EXPECT(OK, fmu->DoStep(fmu->instance, time, TS, true, &event, &terminate, &early, &reached));
    CHECK(!event && !terminate && !early);
}

#endif

/* --- the components of the command line ------------------------------------------------------- */

static void understand(Fmu *fmu, const char *word) {
    char *rest;
    if (word[0] == '>') {
        fmu->second_half = word + 1;
        return;
    }
    const unsigned reference = (unsigned)strtoul(word + 1, &rest, 10);
    const size_t size = *rest == '*' ? strtoul(rest + 1, &rest, 10) : 1;
    CHECK(fmu->n_links < MOST && fmu->n_outputs < MOST && fmu->n_elements + size <= MOST);
    if (*rest == '=') {
        double values[MOST];
        for (size_t i = 0; i < size; i++) values[i] = strtod(rest + 1, &rest);
        start(fmu, word[0], reference, values, size);
    } else if (*rest == '<') {
        Link *link = &fmu->links[fmu->n_links++];
        link->input = reference;
        link->component = strtoul(rest + 1, &rest, 10);
        link->output = (unsigned)strtoul(rest + 1, NULL, 10);
    } else {
        fmu->outputs[fmu->n_outputs++] = reference;
        fmu->n_elements += size;
    }
}

static void load(Fmu *fmu, const char *library) {
    fmu->library = load_library(library);
#define LOAD(result, name, arguments) *(void **)&fmu->name = find_function(fmu->library, PREFIX #name);
    FUNCTIONS(LOAD)
}

/* Creates a component from its arguments and returns the remaining arguments. */
static char **add(char **words) {
    CHECK(n_fmus < MOST);
    Fmu *fmu = &fmus[n_fmus++];
    load(fmu, words[0]);
    fmu->second_half = words[0];
    fmu->guid = words[1];
    fmu->sampled = !strcmp(words[2], "sampled");
    fmu->instance = instantiate(fmu);
    for (words += 3; strcmp(*words, "."); words++) understand(fmu, *words);
    return words + 1;
}

/* --- the master algorithm --------------------------------------------------------------------- */

static void initialize(const Fmu *fmu) {
    enter_initialization(fmu);
    EXPECT(OK, fmu->ExitInitializationMode(fmu->instance));
}

static void feed(const Fmu *fmu, const Link *link) {
    const Fmu *from = &fmus[link->component];
    double value;
    get(from, &link->output, 1, &value, 1);
    set(fmu, link->input, value);
}

static void step(const Fmu *fmu, double time) {
    for (size_t i = 0; i < fmu->n_links; i++) feed(fmu, &fmu->links[i]);
    do_step(fmu, time);
}

static void record(int sampled) {
    for (Fmu *fmu = fmus; fmu < fmus + n_fmus; fmu++)
        if (fmu->sampled == sampled)
            get(fmu, fmu->outputs, fmu->n_outputs, fmu->row, fmu->n_elements);
}

static void write_row(FILE *file) {
    for (const Fmu *fmu = fmus; fmu < fmus + n_fmus; fmu++)
        CHECK(fwrite(fmu->row, sizeof(double), fmu->n_elements, file) == fmu->n_elements);
}

/* Replaces the instance by a new one, perhaps of another binary, given only the bytes of its state. */
static void move(Fmu *fmu) {
    State state = NULL;
    size_t size;
    EXPECT(OK, fmu->GetFMUstate(fmu->instance, &state));
    EXPECT(OK, fmu->SerializedFMUstateSize(fmu->instance, state, &size));
    Byte *bytes = malloc(size);
    EXPECT(OK, fmu->SerializeFMUstate(fmu->instance, state, bytes, size));
    EXPECT(OK, fmu->FreeFMUstate(fmu->instance, &state));
    fmu->FreeInstance(fmu->instance);
    unload_library(fmu->library);
    load(fmu, fmu->second_half);
    fmu->instance = instantiate(fmu);
    EXPECT(OK, fmu->DeSerializeFMUstate(fmu->instance, bytes, size, &state));
    EXPECT(OK, fmu->SetFMUstate(fmu->instance, state));
    EXPECT(OK, fmu->FreeFMUstate(fmu->instance, &state));
    free(bytes);
}

static void end(const Fmu *fmu) {
    EXPECT(OK, fmu->Terminate(fmu->instance));
    fmu->FreeInstance(fmu->instance);
    unload_library(fmu->library);
}

int main(int n_words, char **words) {
    CHECK(n_words > 3);
    FILE *file = fopen(words[1], "wb");
    CHECK(file);
    const size_t steps = strtoul(words[2], NULL, 10);
    for (char **rest = words + 3; rest < words + n_words;) rest = add(rest);
    for (size_t i = 0; i < n_fmus; i++) initialize(&fmus[i]);
    for (size_t k = 0; k < steps; k++) {
        if (k == steps / 2)
            for (size_t i = 0; i < n_fmus; i++) move(&fmus[i]);
        record(0);
        for (size_t i = 0; i < n_fmus; i++) step(&fmus[i], TS + (double)k * TS);
        record(1);
        write_row(file);
    }
    for (size_t i = 0; i < n_fmus; i++) end(&fmus[i]);
    CHECK(!fclose(file));
    return 0;
}
