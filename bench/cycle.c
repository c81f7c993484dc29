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
 *     in=REF            a real input that a cycle sets to another value each time
 *     in=REF:VALUE      a real input that a cycle sets to the same value each time
 *     in=REF:NAME.I     mode loop: a real input that receives output I, from 0, of the FMU NAME
 *     out=REF           a real output that a cycle reads
 *     real=REF:VALUE    a real parameter or start value, set before the initialization
 *     integer=REF:VALUE an Integer or Enumeration parameter, likewise
 *     boolean=REF:VALUE a Boolean parameter, likewise
 *
 * MODE is one of
 *
 *     cycle   COUNT cycles of one instance: fmi2SetReal of all inputs in one call, fmi2DoStep by
 *             1 ms, fmi2GetReal of all outputs in one call
 *     many    the same cycles, distributed over 1, 10, 100, 1000, 10000 instances in turn
 *     threads COUNT cycles in each of 1, 2, ... threads, one per core at most; each thread has an
 *             instance of its own; the time is the duration of all, divided by all cycles
 *     loop    COUNT steps of all FMUs, coupled: in each step one cycle of each, in their order
 *     life    COUNT simultaneous instances: time from fmi2Instantiate to fmi2FreeInstance and
 *             memory of one, with and without initialization
 *
 * Every repeat measures all FMUs in turn, so that a temporary slowdown of the machine affects all of
 * them; and it creates new instances, so that unstable models do not overflow if COUNT is small
 * enough. The first error ends the run.
 * The output is one JSON object per line, with the times (ns) of the repeats in their order.
 * Build: cc -O2 -o cycle cycle.c -ldl -lm -lpthread */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <malloc.h>
#include <math.h>
#include <pthread.h>
#include <sched.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "../tests/c/fmi2.h"

/* --- the FMUs of the command line ------------------------------------------------------------- */

enum { MAX_REFERENCES = 64, MAX_FMUS = 64 };

typedef struct {
    unsigned reference;
    double value;     /* NAN: the signal, or that of the source */
    const char *from; /* the source, NAME.I, or NULL */
} Assignment;

typedef struct {
    Assignment items[MAX_REFERENCES];
    size_t n;
} Assignments;

typedef struct {
    const char *name, *binary, *guid, *resources;
    Assignments in, out, reals, integers, booleans;
    double *times;  /* ns, one per repeat */
    double *others; /* ns, second measurement of a mode */
    double last;    /* the first output after the last cycle, so that results can be compared */
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
    if (*end == ':') {
        const char *rest = end + 1;
        item.value = strtod(rest, &end);
        if (end == rest && !needs_value) item = (Assignment){item.reference, NAN, rest};
    }
    if (end == text || (*end && !item.from) || (needs_value && isnan(item.value)))
        fail(text, "not a variable");
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
    else if (IS("boolean")) append(fmu, &fmu->booleans, value, 1);
    else fail(word, "unknown key");
}

/* The step (s), and the time at the start, as in the loops of the paper. */
static const double TS = 0.001;

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
    for (size_t i = 0; i < fmu->booleans.n; i++) {
        Assignment item = fmu->booleans.items[i];
        int value = item.value != 0;
        must(fmu, fmu->SetBoolean(c, &item.reference, 1, &value), "fmi2SetBoolean");
    }
    must(fmu, fmu->SetupExperiment(c, 0, 0, TS, 0, 0), "fmi2SetupExperiment");
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
    double inputs[PERIOD][MAX_REFERENCES], outputs[MAX_REFERENCES];
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

/* One cycle; returns the combined status of its calls. Hosts make no call without variables. */
static inline Status cycle(Fmu *fmu, Plan *plan, Component c, size_t k, const double *inputs) {
    size_t n_in = fmu->in.n, n_out = fmu->out.n;
    unsigned status = OK;
    if (n_in) status |= fmu->SetReal(c, plan->in, n_in, inputs);
    status |= fmu->DoStep(c, TS * (double)(k + 1), TS, 1);
    if (n_out) status |= fmu->GetReal(c, plan->out, n_out, plan->outputs);
    return status;
}

/* Runs the steps from `first` up to, not including, `last` of every instance in turn. Returns the
 * combined status of all calls. */
static Status run(Fmu *fmu, Plan *plan, Component *instances, size_t n, size_t first, size_t last) {
    unsigned status = OK;
    for (size_t k = first; k < last; k++)
        for (size_t i = 0; i < n; i++)
            status |= cycle(fmu, plan, instances[i], k, plan->inputs[k % PERIOD]);
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
    fmu->last = plan->outputs[0];
    for (size_t i = 0; i < n; i++) end(fmu, instances[i]);
    free(instances);
    free(plan);
    return time;
}

/* Prints a member of a JSON object: the times of the repeats. */
static void print_times(const char *name, const double *times, size_t repeats) {
    printf(", \"%s\": [", name);
    for (size_t i = 0; i < repeats; i++) printf("%s%.3f", i ? ", " : "", times[i]);
    printf("]");
}

static void measure_cycles(Fmu *fmus, size_t n_fmus, size_t n, size_t count, size_t repeats) {
    for (size_t repeat = 0; repeat < repeats; repeat++)
        for (Fmu *fmu = fmus; fmu < fmus + n_fmus; fmu++)
            fmu->times[repeat] = cycle_time(fmu, n, count);
    for (Fmu *fmu = fmus; fmu < fmus + n_fmus; fmu++) {
        printf("{\"fmu\": \"%s\", \"instances\": %zu, \"last_output\": %.17g", fmu->name, n,
               fmu->last);
        print_times("ns", fmu->times, repeats);
        printf("}\n");
    }
}

/* --- threads ---------------------------------------------------------------------------------- */

typedef struct {
    pthread_t thread;
    pthread_barrier_t *start;
    Fmu *fmu;
    size_t count, core;
    double begin, end;
} Worker;

/* Moves the thread to a core, as the system may take longer than a measurement to spread threads. */
static void move_to(size_t core) {
    cpu_set_t cores;
    CPU_ZERO(&cores);
    CPU_SET(core, &cores);
    pthread_setaffinity_np(pthread_self(), sizeof cores, &cores); /* not allowed everywhere */
}

static void *work(void *argument) {
    Worker *worker = argument;
    Fmu *fmu = worker->fmu;
    move_to(worker->core);
    Plan *plan = prepare(fmu);
    Component c = instantiate(fmu);
    initialize(fmu, c);
    size_t warm = 1 + worker->count / 8;
    must(fmu, run(fmu, plan, &c, 1, 0, warm), "a warm-up cycle");
    pthread_barrier_wait(worker->start);
    worker->begin = now();
    Status status = run(fmu, plan, &c, 1, warm, warm + worker->count);
    worker->end = now();
    must(fmu, status, "a cycle");
    end(fmu, c);
    free(plan);
    return NULL;
}

/* The time (ns) from the first cycle of any thread to the last one, per cycle of all threads. */
static double threads_time(Fmu *fmu, size_t n, size_t count) {
    Worker *workers = calloc(n, sizeof *workers);
    pthread_barrier_t start;
    pthread_barrier_init(&start, NULL, (unsigned)n);
    for (Worker *worker = workers; worker < workers + n; worker++) {
        size_t core = (size_t)(worker - workers);
        *worker = (Worker){.start = &start, .fmu = fmu, .count = count, .core = core};
        if (pthread_create(&worker->thread, NULL, work, worker)) fail(fmu->name, "no thread");
    }
    double begin = INFINITY, end = 0;
    for (Worker *worker = workers; worker < workers + n; worker++) {
        pthread_join(worker->thread, NULL);
        begin = fmin(begin, worker->begin);
        end = fmax(end, worker->end);
    }
    pthread_barrier_destroy(&start);
    free(workers);
    return (end - begin) / (double)(n * count);
}

static void measure_threads(Fmu *fmus, size_t n_fmus, size_t count, size_t repeats) {
    long cores = sysconf(_SC_NPROCESSORS_ONLN);
    if (cores < 1) fail("threads", "the number of cores is unknown");
    size_t n_cores = (size_t)cores;
    /* In alternation, too, as ratios of numbers of threads are of interest. */
    double *times = calloc(n_fmus * n_cores * repeats, sizeof *times);
    for (size_t repeat = 0; repeat < repeats; repeat++)
        for (size_t f = 0; f < n_fmus; f++)
            for (size_t n = 1; n <= n_cores; n++)
                times[(f * n_cores + n - 1) * repeats + repeat] = threads_time(&fmus[f], n, count);
    for (size_t f = 0; f < n_fmus; f++)
        for (size_t n = 1; n <= n_cores; n++) {
            printf("{\"fmu\": \"%s\", \"threads\": %zu", fmus[f].name, n);
            print_times("ns", times + (f * n_cores + n - 1) * repeats, repeats);
            printf("}\n");
        }
    free(times);
}

/* --- coupled FMUs ----------------------------------------------------------------------------- */

/* The output that an input NAME.I receives. */
static const double *source(const char *from, const Fmu *fmus, Plan *const *plans, size_t n_fmus) {
    const char *dot = strrchr(from, '.');
    for (size_t f = 0; dot && f < n_fmus; f++) {
        size_t length = strlen(fmus[f].name), i = strtoul(dot + 1, NULL, 10);
        if ((size_t)(dot - from) == length && !strncmp(from, fmus[f].name, length) &&
            i < fmus[f].out.n)
            return &plans[f]->outputs[i];
    }
    fail(from, "no such output");
    return NULL;
}

/* The time (ns) per step of `count` steps of all FMUs, coupled. */
static double loop_time(Fmu *fmus, size_t n_fmus, size_t count) {
    Plan *plans[MAX_FMUS];
    Component instances[MAX_FMUS];
    const double *sources[MAX_FMUS][MAX_REFERENCES];
    for (size_t f = 0; f < n_fmus; f++) {
        Fmu *fmu = &fmus[f];
        plans[f] = prepare(fmu);
        initialize(fmu, instances[f] = instantiate(fmu));
        if (!fmu->out.n) continue;
        Plan *plan = plans[f];
        must(fmu, fmu->GetReal(instances[f], plan->out, fmu->out.n, plan->outputs), "fmi2GetReal");
    }
    for (size_t f = 0; f < n_fmus; f++)
        for (size_t i = 0; i < fmus[f].in.n; i++) {
            const char *from = fmus[f].in.items[i].from;
            sources[f][i] = from ? source(from, fmus, plans, n_fmus) : &plans[f]->inputs[0][i];
        }
    unsigned status = OK;
    double inputs[MAX_REFERENCES], begin = now();
    for (size_t k = 0; k < count; k++)
        for (size_t f = 0; f < n_fmus; f++) {
            for (size_t i = 0; i < fmus[f].in.n; i++) inputs[i] = *sources[f][i];
            status |= cycle(&fmus[f], plans[f], instances[f], k, inputs);
        }
    double time = (now() - begin) / (double)count;
    must(fmus, status, "a step");
    for (size_t f = 0; f < n_fmus; f++) {
        fmus[f].last = plans[f]->outputs[0];
        end(&fmus[f], instances[f]);
        free(plans[f]);
    }
    return time;
}

static void measure_loop(Fmu *fmus, size_t n_fmus, size_t count, size_t repeats) {
    for (size_t repeat = 0; repeat < repeats; repeat++)
        fmus->times[repeat] = loop_time(fmus, n_fmus, count);
    printf("{\"last_outputs\": {");
    for (size_t f = 0; f < n_fmus; f++)
        printf("%s\"%s\": %.17g", f ? ", " : "", fmus[f].name, fmus[f].last);
    printf("}");
    print_times("ns", fmus->times, repeats);
    printf("}\n");
}

/* --- instances -------------------------------------------------------------------------------- */

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
        printf("{\"fmu\": \"%s\", \"bytes\": %.1f, \"initialized_bytes\": %.1f", fmus[f].name,
               bytes[f], bytes_ready[f]);
        print_times("ns", fmus[f].times, repeats);
        print_times("initialized_ns", fmus[f].others, repeats);
        printf("}\n");
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
    else if (!strcmp(mode, "threads")) measure_threads(fmus, n_fmus, count, repeats);
    else if (!strcmp(mode, "loop")) measure_loop(fmus, n_fmus, count, repeats);
    else fail(mode, "the modes are cycle, many, threads, loop, life");
    return 0;
}
