/* Measures the run time and memory of FMI 2.0 co-simulation binaries, from any vendor.
 *
 * usage: cycle MODE COUNT REPEATS FMU [-- FMU]...
 *
 * An FMU is a list of arguments KEY=VALUE:
 *
 *     name=TEXT         its name in the output
 *     binary=FILE       its binary, for dlopen
 *     guid=TEXT         its GUID, as in its modelDescription.xml
 *     resources=URI     its resource location; default: empty
 *     in=REF[:VALUE]    a real input that a cycle sets, to VALUE or to a varying signal
 *     out=REF           a real output that a cycle reads
 *     real=REF:VALUE    a real parameter, set before the initialization
 *     integer=REF:VALUE an Integer or Enumeration parameter, likewise
 *
 * MODE is one of
 *
 *     cycle   COUNT cycles of one instance: fmi2SetReal of all inputs in one call, fmi2DoStep by
 *             1 ms, fmi2GetReal of all outputs in one call
 *     many    the same cycles, distributed over 1, 10, 100, 1000, 10000 instances in turn
 *     life    COUNT simultaneous instances: time from fmi2Instantiate to fmi2FreeInstance and
 *             memory of one, with and without initialization
 *
 * Every repeat measures all FMUs in turn, so that a temporary slowdown of the machine affects all of
 * them; and it creates new instances, so that unstable models do not overflow if COUNT is small
 * enough. The first error ends the run.
 * The output is one JSON object per line. Build: cc -O2 -o cycle cycle.c -ldl */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <malloc.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "../tests/c/fmi2.h"

/* --- the FMUs of the command line ------------------------------------------------------------- */

enum { MAX_REFERENCES = 64, MAX_FMUS = 32 };

typedef struct {
    unsigned reference;
    double value; /* NAN: the signal */
} Assignment;

typedef struct {
    Assignment items[MAX_REFERENCES];
    size_t n;
} Assignments;

typedef struct {
    const char *name, *binary, *guid, *resources;
    Assignments in, out, reals, integers;
    double *times;  /* ns, one per repeat */
    double *others; /* ns, second measurement of a mode */
    double last;    /* the last output, so that results can be compared */
#define MEMBER(type, name, arguments) type(*name) arguments;
    FUNCTIONS(MEMBER)
} Fmu;

static void fail(const char *who, const char *what) {
    fprintf(stderr, "cycle: %s: %s\n", who, what);
    exit(1);
}

static void load(Fmu *fmu) {
    void *library = dlopen(fmu->binary, RTLD_NOW | RTLD_LOCAL);
    if (!library) fail(fmu->name, dlerror());
#define BIND(type, function, arguments)                                                           \
    *(void **)&fmu->function = dlsym(library, "fmi2" #function);                                  \
    if (!fmu->function) fail(fmu->name, "fmi2" #function " is missing");
    FUNCTIONS(BIND)
}

static void append(Fmu *fmu, Assignments *list, const char *text, int needs_value) {
    if (list->n == MAX_REFERENCES) fail(fmu->name, "too many variables");
    char *end;
    Assignment item = {.reference = (unsigned)strtoul(text, &end, 10), .value = NAN};
    if (*end == ':') item.value = strtod(end + 1, &end);
    if (end == text || *end || (needs_value && isnan(item.value))) fail(text, "not a variable");
    list->items[list->n++] = item;
}

static void option(Fmu *fmu, const char *word) {
    const char *value = strchr(word, '=');
    if (!value) fail(word, "expected KEY=VALUE");
    size_t length = (size_t)(value++ - word);
#define IS(key) (length == strlen(key) && !strncmp(word, key, length))
    if (IS("name")) fmu->name = value;
    else if (IS("binary")) fmu->binary = value;
    else if (IS("guid")) fmu->guid = value;
    else if (IS("resources")) fmu->resources = value;
    else if (IS("in")) append(fmu, &fmu->in, value, 0);
    else if (IS("out")) append(fmu, &fmu->out, value, 0);
    else if (IS("real")) append(fmu, &fmu->reals, value, 1);
    else if (IS("integer")) append(fmu, &fmu->integers, value, 1);
    else fail(word, "unknown key");
}

/* --- an instance ------------------------------------------------------------------------------ */

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

static const Callbacks CALLBACKS = {logger, calloc, free, NULL, NULL};

static void must(const Fmu *fmu, Status status, const char *call) {
    if (status != OK && status != WARNING) fail(fmu->name, call);
}

static Component instantiate(const Fmu *fmu) {
    Component c = fmu->Instantiate(fmu->name, CO_SIMULATION, fmu->guid, fmu->resources, &CALLBACKS,
                                   0, 0);
    if (!c) fail(fmu->name, "fmi2Instantiate");
    return c;
}

static void initialize(const Fmu *fmu, Component c) {
    for (size_t i = 0; i < fmu->reals.n; i++) {
        Assignment item = fmu->reals.items[i];
        must(fmu, fmu->SetReal(c, &item.reference, 1, &item.value), "fmi2SetReal");
    }
    for (size_t i = 0; i < fmu->integers.n; i++) {
        Assignment item = fmu->integers.items[i];
        int value = (int)item.value;
        must(fmu, fmu->SetInteger(c, &item.reference, 1, &value), "fmi2SetInteger");
    }
    must(fmu, fmu->SetupExperiment(c, 0, 0, 0, 0, 0), "fmi2SetupExperiment");
    must(fmu, fmu->EnterInitializationMode(c), "fmi2EnterInitializationMode");
    must(fmu, fmu->ExitInitializationMode(c), "fmi2ExitInitializationMode");
}

static void end(const Fmu *fmu, Component c) {
    must(fmu, fmu->Terminate(c), "fmi2Terminate");
    fmu->FreeInstance(c);
}

/* --- measuring -------------------------------------------------------------------------------- */

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e9 * (double)t.tv_sec + (double)t.tv_nsec;
}

/* The signal: values that change in every cycle, with mean zero, so that integrals stay bounded, and
 * large enough to avoid denormal products. */
enum { PERIOD = 64 };
static double signal[PERIOD];

static void make_signal(void) {
    unsigned state = 1;
    for (int i = 0; i < PERIOD; i += 2) {
        state = state * 1664525u + 1013904223u;
        signal[i] = 0.01 + 0.1 * (state >> 8) / (1 << 24);
        signal[i + 1] = -signal[i];
    }
}

/* PERIOD precomputed rows of inputs, so that little more than the FMU is measured. */
typedef struct {
    unsigned in[MAX_REFERENCES], out[MAX_REFERENCES];
    double inputs[PERIOD][MAX_REFERENCES];
} Plan;

static Plan *prepare(const Fmu *fmu) {
    Plan *plan = calloc(1, sizeof *plan);
    for (size_t i = 0; i < fmu->out.n; i++) plan->out[i] = fmu->out.items[i].reference;
    for (size_t i = 0; i < fmu->in.n; i++) {
        Assignment item = fmu->in.items[i];
        plan->in[i] = item.reference;
        for (size_t k = 0; k < PERIOD; k++)
            plan->inputs[k][i] = isnan(item.value) ? signal[(k + i) % PERIOD] : item.value;
    }
    return plan;
}

/* Runs the steps from `first` up to, not including, `last` of every instance in turn. Returns the
 * combined status of all calls. */
static Status run(Fmu *fmu, const Plan *plan, Component *instances, size_t n, size_t first,
                  size_t last) {
    double outputs[MAX_REFERENCES] = {0};
    size_t n_in = fmu->in.n, n_out = fmu->out.n;
    unsigned status = OK;
    for (size_t k = first; k < last; k++) {
        const double *inputs = plan->inputs[k % PERIOD];
        double time = 0.001 * (double)k;
        for (size_t i = 0; i < n; i++) {
            Component c = instances[i];
            status |= fmu->SetReal(c, plan->in, n_in, inputs);
            status |= fmu->DoStep(c, time, 0.001, 1);
            status |= fmu->GetReal(c, plan->out, n_out, outputs);
        }
    }
    fmu->last = outputs[0];
    return status;
}

/* The time (ns) per cycle of about `count` cycles distributed over `n` instances. */
static double cycle_time(Fmu *fmu, size_t n, size_t count) {
    Plan *plan = prepare(fmu);
    Component *instances = calloc(n, sizeof *instances);
    for (size_t i = 0; i < n; i++) initialize(fmu, instances[i] = instantiate(fmu));
    size_t steps = (count + n - 1) / n, warm = 1 + steps / 8; /* the first steps fill caches */
    must(fmu, run(fmu, plan, instances, n, 0, warm), "a warm-up cycle");
    double begin = now();
    Status status = run(fmu, plan, instances, n, warm, warm + steps);
    double time = (now() - begin) / (double)(n * steps);
    must(fmu, status, "a cycle");
    for (size_t i = 0; i < n; i++) end(fmu, instances[i]);
    free(instances);
    free(plan);
    return time;
}

static int ascending(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Prints a member of a JSON object for the minimum and one for the median of the repeats. */
static void print_times(const char *what, double *times, size_t repeats) {
    qsort(times, repeats, sizeof *times, ascending);
    printf(", \"%smin_ns\": %.3f, \"%smedian_ns\": %.3f", what, times[0], what,
           (times[(repeats - 1) / 2] + times[repeats / 2]) / 2);
}

static void measure_cycles(Fmu *fmus, size_t n_fmus, size_t n, size_t count, size_t repeats) {
    for (size_t repeat = 0; repeat < repeats; repeat++)
        for (Fmu *fmu = fmus; fmu < fmus + n_fmus; fmu++)
            fmu->times[repeat] = cycle_time(fmu, n, count);
    for (Fmu *fmu = fmus; fmu < fmus + n_fmus; fmu++) {
        printf("{\"fmu\": \"%s\", \"mode\": \"cycle\", \"instances\": %zu, \"cycles\": %zu, "
               "\"repeats\": %zu",
               fmu->name, n, count, repeats);
        print_times("", fmu->times, repeats);
        printf(", \"last_output\": %.17g}\n", fmu->last);
    }
}

static double allocated(void) {
    struct mallinfo2 info = mallinfo2();
    return (double)(info.uordblks + info.hblkhd);
}

static void measure_lives(Fmu *fmus, size_t n_fmus, size_t n, size_t repeats) {
    Component *instances = calloc(n, sizeof *instances);
    double bytes[MAX_FMUS], bytes_ready[MAX_FMUS];
    for (size_t repeat = 0; repeat < repeats; repeat++) {
        for (size_t f = 0; f < n_fmus; f++) {
            Fmu *fmu = &fmus[f];
            double before = allocated(), begin = now();
            for (size_t i = 0; i < n; i++) instances[i] = instantiate(fmu);
            double made = now();
            bytes[f] = (allocated() - before) / (double)n;
            double between = now();
            for (size_t i = 0; i < n; i++) fmu->FreeInstance(instances[i]);
            fmu->times[repeat] = (made - begin + now() - between) / (double)n;

            begin = now();
            for (size_t i = 0; i < n; i++) initialize(fmu, instances[i] = instantiate(fmu));
            made = now();
            bytes_ready[f] = (allocated() - before) / (double)n;
            between = now();
            for (size_t i = 0; i < n; i++) end(fmu, instances[i]);
            fmu->others[repeat] = (made - begin + now() - between) / (double)n;
        }
    }
    for (size_t f = 0; f < n_fmus; f++) {
        printf("{\"fmu\": \"%s\", \"mode\": \"life\", \"instances\": %zu, \"repeats\": %zu",
               fmus[f].name, n, repeats);
        print_times("", fmus[f].times, repeats);
        print_times("initialized_", fmus[f].others, repeats);
        printf(", \"bytes\": %.1f, \"initialized_bytes\": %.1f}\n", bytes[f], bytes_ready[f]);
    }
    free(instances);
}

int main(int n_words, char **words) {
    static Fmu fmus[MAX_FMUS];
    if (n_words < 5) fail("usage", "cycle MODE COUNT REPEATS FMU [-- FMU]...");
    const char *mode = words[1];
    size_t count = strtoul(words[2], NULL, 10), repeats = strtoul(words[3], NULL, 10), n_fmus = 1;
    if (!count || !repeats) fail(mode, "COUNT and REPEATS must be at least 1");
    for (int i = 4; i < n_words; i++) {
        if (strcmp(words[i], "--")) option(&fmus[n_fmus - 1], words[i]);
        else if (++n_fmus > MAX_FMUS) fail(mode, "too many FMUs");
    }
    for (Fmu *fmu = fmus; fmu < fmus + n_fmus; fmu++) {
        if (!fmu->name || !fmu->binary || !fmu->guid) fail(mode, "an FMU needs name, binary, guid");
        if (!fmu->resources) fmu->resources = "";
        fmu->times = calloc(repeats, sizeof *fmu->times);
        fmu->others = calloc(repeats, sizeof *fmu->others);
        load(fmu);
    }
    make_signal();
    if (!strcmp(mode, "cycle")) measure_cycles(fmus, n_fmus, 1, count, repeats);
    else if (!strcmp(mode, "life")) measure_lives(fmus, n_fmus, count, repeats);
    else if (!strcmp(mode, "many"))
        for (size_t n = 1; n <= 10000; n *= 10) measure_cycles(fmus, n_fmus, n, count, repeats);
    else fail(mode, "the modes are cycle, many, life");
    return 0;
}
