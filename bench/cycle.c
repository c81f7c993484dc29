/* Measures the run time of co-simulation binaries of FMI 2.0 and 3.0, from any vendor.
 *
 * usage: cycle MODE COUNT REPEATS FMU [-- FMU]...
 *
 * An FMU is a list of arguments KEY=VALUE:
 *
 *     name=TEXT         its name in the output
 *     binary=FILE       its binary, for dlopen
 *     fmi=VERSION       2, the default, or 3
 *     guid=TEXT         its GUID or instantiation token, as in its modelDescription.xml
 *     resources=TEXT    its resources: a URI in FMI 2.0, a path in FMI 3.0; default: none
 *     in=REF            a real input that a cycle sets to another value each time
 *     in=REF:VALUE      a real input that a cycle sets to the same value each time
 *     in=REF:NAME.I     mode loop: a real input that receives output I, from 0, of the FMU NAME
 *     out=REF           a real output that a cycle reads
 *     out=REF:COUNT     FMI 3.0: an output that is an array of COUNT elements
 *     real=REF:VALUE    a real parameter or start value, set before the initialization
 *     integer=REF:VALUE an Integer, Int64 or Enumeration parameter, likewise
 *     boolean=REF:VALUE a Boolean parameter, likewise
 *
 * MODE is one of
 *
 *     cycle   COUNT cycles of one instance: set all inputs in one call, step by 1 ms, get all
 *             outputs in one call
 *     many    the same cycles, distributed over 1, 10, 100, 1000, 10000 instances in turn
 *     threads COUNT cycles in each of 1, 2, ... threads, one per core at most; each thread has an
 *             instance of its own; the time is the duration of all, divided by all cycles
 *     loop    COUNT steps of all FMUs, coupled: in each step one cycle of each, in their order
 *
 * Every repeat measures all FMUs in turn, so that a temporary slowdown of the machine affects all of
 * them; and it creates new instances, so that unstable models do not overflow if COUNT is small
 * enough. The first error ends the run.
 * The output is one JSON object per line, with the times (ns) of the repeats in their order.
 * Build: cc -O2 -o cycle cycle.c -ldl -lm -lpthread */

#define _GNU_SOURCE
#include <pthread.h>
#include <sched.h>
#include <time.h>
#include <unistd.h>

#include "fmu.h"

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
INLINE Status cycle(int fmi, const Fmu *fmu, Plan *plan, Component c, size_t k,
                    const double *inputs) {
    unsigned status = OK;
    if (fmu->in.n) status |= set_inputs(fmi, fmu, c, plan->in, inputs);
    status |= step(fmi, fmu, c, TS * (double)(k + 1));
    if (fmu->out.n) status |= get_outputs(fmi, fmu, c, plan->out, plan->outputs);
    return status;
}

/* Runs the steps from `first` up to, not including, `last` of every instance in turn. Returns the
 * combined status of all calls. */
INLINE Status run_in(int fmi, const Fmu *fmu, Plan *plan, Component *instances, size_t n,
                     size_t first, size_t last) {
    unsigned status = OK;
    for (size_t k = first; k < last; k++)
        for (size_t i = 0; i < n; i++)
            status |= cycle(fmi, fmu, plan, instances[i], k, plan->inputs[k % PERIOD]);
    return status;
}

static Status run(const Fmu *fmu, Plan *plan, Component *instances, size_t n, size_t first,
                  size_t last) {
    if (fmu->fmi == 3) return run_in(3, fmu, plan, instances, n, first, last);
    return run_in(2, fmu, plan, instances, n, first, last);
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
            i < fmus[f].n_outputs)
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
        Status status = get_outputs(fmu->fmi, fmu, instances[f], plan->out, plan->outputs);
        must(fmu, status, "the first outputs");
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
            status |= cycle(fmus[f].fmi, &fmus[f], plans[f], instances[f], k, inputs);
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
        if (!fmu->fmi) fmu->fmi = 2;
        fmu->times = calloc(repeats, sizeof *fmu->times);
        load(fmu);
    }
    make_signal();
    if (!strcmp(mode, "cycle")) measure_cycles(fmus, n_fmus, 1, count, repeats);
    else if (!strcmp(mode, "many"))
        for (size_t n = 1; n <= 10000; n *= 10) measure_cycles(fmus, n_fmus, n, count, repeats);
    else if (!strcmp(mode, "threads")) measure_threads(fmus, n_fmus, count, repeats);
    else if (!strcmp(mode, "loop")) measure_loop(fmus, n_fmus, count, repeats);
    else fail(mode, "the modes are cycle, many, threads, loop");
    return 0;
}
