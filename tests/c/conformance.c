/* A driven pendulum as an FMU for model exchange and co-simulation, with variables of every type:
 *
 *     x' = v                                       y = x, x^2 or x^3 (by `shape`) + u / 2
 *     v' = -damping v - stiffness sin x + u        energy = v^2 / 2 + stiffness (1 - cos x)
 *     omega = sqrt(stiffness)                      limited = sin x
 *     sampled = x when it was sampled last         count = samples since the start
 *     m = n + offset     choice = shape            c = b, or not b      above = (x > 0)
 *     echo = label/text
 *
 * It keeps to FMI 2.0, unless it is compiled with one of the defects in `conformance.h`.
 *
 * In co-simulation, the step size of the integrator is fixed. Its steps start again where an input or
 * a parameter changes, so that results do not depend on the communication step size.
 */
#define _GNU_SOURCE
#include "conformance.h"
#include "stubs.h"

#define GUID "{conformance}"
#define TOLERANCE 1e-9        /* of times [s] */
#define STEP 1e-3             /* of the integrator [s] */
#define LONGEST_STEP 1e3      /* that fmi2DoStep takes [s] */
#define COUNT_OF(array) (sizeof(array) / sizeof *(array))

/* --- data ----------------------------------------------------------------------------------------- */

enum { TIME, U, DAMPING, STIFFNESS, OMEGA, G, X, V, DER_X, DER_V, Y, ENERGY, LIMITED, SAMPLED, PERIOD };
enum { N = 100, OFFSET, COUNT, M, SHAPE, CHOICE };
enum { B = 200, INVERT, C, ABOVE };
enum { LABEL = 300, TEXT, ECHO };
enum { LINEAR = 1, QUADRATIC = 2, CUBIC = 4 };
enum { TEXT_SIZE = 256 };

enum Class { INPUT, FIXED, TUNABLE, STATE, CALCULATED };

/* When a variable may be set, and to what. */
typedef struct {
    enum Class class;
    double min, max;
} Rule;

#define ANY -DBL_MAX, DBL_MAX
static const Rule real_rules[] = {
    [TIME] = {CALCULATED, ANY},     [U] = {INPUT, -100, 100},          [DAMPING] = {FIXED, 0, 10},
    [STIFFNESS] = {TUNABLE, 0.01, 100}, [OMEGA] = {CALCULATED, ANY},   [G] = {CALCULATED, ANY},
    [X] = {STATE, ANY},             [V] = {STATE, ANY},                [DER_X] = {CALCULATED, ANY},
    [DER_V] = {CALCULATED, ANY},    [Y] = {CALCULATED, ANY},           [ENERGY] = {CALCULATED, ANY},
    [LIMITED] = {CALCULATED, ANY},  [SAMPLED] = {CALCULATED, ANY},     [PERIOD] = {FIXED, 0.001, 1000},
};
static const Rule integer_rules[] = {
    [N - N] = {INPUT, ANY},        [OFFSET - N] = {FIXED, -100, 100}, [COUNT - N] = {CALCULATED, ANY},
    [M - N] = {CALCULATED, ANY},   [SHAPE - N] = {FIXED, 1, 4},       [CHOICE - N] = {CALCULATED, ANY},
};
static const Rule boolean_rules[] = {
    [B - B] = {INPUT, 0, 1}, [INVERT - B] = {TUNABLE, 0, 1}, [C - B] = {CALCULATED, ANY},
    [ABOVE - B] = {CALCULATED, ANY},
};
static const Rule string_rules[] = {
    [LABEL - LABEL] = {FIXED, ANY}, [TEXT - LABEL] = {INPUT, ANY}, [ECHO - LABEL] = {CALCULATED, ANY},
};

/* The state of the model. It holds no pointers and its padding is zero, so that it can be serialized. */
typedef struct {
    double start, now, stop, tolerance;
    double damping, stiffness, period, g;
    double x[2];
    /* The input about the time `u_time`: value, first and second derivative. */
    double u[3], u_time;
    /* The integrator has taken `grid_steps` steps since `grid_start` and is at `grid`. */
    double grid_start, grid[2], grid_steps;
    double sampled;
    int stop_defined, n, offset, count, shape, b, invert, above;
    char label[TEXT_SIZE], text[TEXT_SIZE];
} Data;

enum Phase {
    INSTANTIATED = 1, INITIALIZATION = 2, EVENT_MODE = 4, CONTINUOUS_TIME = 8, STEP_COMPLETE = 16,
    STEP_FAILED = 32, TERMINATED_PHASE = 64,
};
enum {
    ALIVE = 127,
    READABLE = INITIALIZATION | EVENT_MODE | CONTINUOUS_TIME | STEP_COMPLETE | STEP_FAILED | TERMINATED_PHASE,
    STEPPED = STEP_COMPLETE | STEP_FAILED | TERMINATED_PHASE,
    RUNNING = EVENT_MODE | CONTINUOUS_TIME,
};

/* What fmi2GetFMUstate copies. */
typedef struct {
    int phase, model_exchange;
    Data data;
} Snapshot;

typedef struct {
    char magic[8];
    uint32_t size, reserved;
    uint64_t checksum;
} Header;

typedef struct {
    double never_set; /* read by defects only */
    Callbacks functions;
    const Callbacks *kept_functions;
    char *name;
    const char *kept_name;
    int logging, categories;
    Status last_status;
    Snapshot now;
    char echo[2 * TEXT_SIZE];
    /* Used by defects only. */
    Data held;
    double *history;
    int failed, keep_time, reads, has_seen_nan;
} Instance;

typedef struct {
    int new_discrete_states_needed, terminate_simulation, nominals_changed, values_changed;
    int next_event_time_defined;
    double next_event_time;
} EventInfo;

/* --- messages ------------------------------------------------------------------------------------- */

enum { ERRORS = 1, EVENTS = 2, ALL_MESSAGES = 4 };
static const char *const category_names[] = {"logStatusError", "logEvents", "logAll"};

static void say(Instance *c, Status status, int category, const char *format, ...) {
    Callbacks *to = HAS(KEEPS_CALLBACK_POINTER) ? (Callbacks *)c->kept_functions : &c->functions;
    if (!to->logger && !HAS(NULL_LOGGER_CALLED)) return;
    int wanted = c->logging && (c->categories & (category | ALL_MESSAGES));
    if (HAS(LOG_CATEGORY_IGNORED)) wanted = c->logging;
    if (!wanted && !HAS(LOGS_WITHOUT_CONSENT) && !HAS(NULL_LOGGER_CALLED)) return;
    char text[1000];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    const char *category_name = category_names[category == ERRORS ? 0 : 1];
    const char *name = c->name;
    void *environment = to->environment;
    if (HAS(LOGS_NULL_CATEGORY)) category_name = NULL;
    if (HAS(LOGS_UNDECLARED_CATEGORY)) category_name = "debug";
    if (HAS(LOGS_WRONG_ENVIRONMENT)) environment = c;
    if (HAS(LOGS_WRONG_NAME)) name = "model";
    if (HAS(KEEPS_ARGUMENT_STRINGS)) name = c->kept_name;
    if (HAS(LOGS_WRONG_STATUS)) status = OK;
    if (HAS(LOGGER_FORMAT_FROM_DATA))
        to->logger(environment, name, status, category_name, text);
    else
        to->logger(environment, name, status, category_name, "%s", text);
}

/* Refuses a call. */
#define REFUSE(c, ...) \
    do { \
        if (HAS(EXITS_ON_ERROR)) exit(1); \
        if (!HAS(STEP_ERROR_WITHOUT_MESSAGE)) say(c, ERROR, ERRORS, __VA_ARGS__); \
        (c)->failed = 1; \
        return ERROR; \
    } while (0)

/* Refuses a call that the state does not allow. */
#define ALLOWED_IN(c, phases) \
    do { \
        if (!(c)) return ERROR; \
        if (!((c)->now.phase & (phases))) \
            REFUSE(c, "%s is not allowed in state %d", __func__, (c)->now.phase); \
    } while (0)

static void *allocate(Instance *c, size_t size) {
    return c->functions.allocate ? c->functions.allocate(1, size) : calloc(1, size);
}

static void release(Instance *c, void *block) {
    if (c->functions.release) c->functions.release(block);
    else free(block);
}

/* --- model ---------------------------------------------------------------------------------------- */

static _Thread_local double thread_gain;
static int instances_made;
static double shared_torque;

static double input(const Data *d, double time) {
    if (HAS(SHARED_STATIC)) return shared_torque;
    double t = time - d->u_time;
    return d->u[0] + t * (d->u[1] + t * d->u[2] / 2);
}

static double input_rate(const Data *d, double time) { return d->u[1] + (time - d->u_time) * d->u[2]; }

static void derivatives(const Data *d, double time, const double *x, double *result) {
    double damping = d->damping;
    if (HAS(PARAMETER_IGNORED)) damping = 0.3;
    if (HAS(DEPENDS_ON_STOP_TIME) && d->stop_defined) damping += 0.01 * d->stop;
    double stiffness = HAS(TUNABLE_IGNORED) ? 4 : d->stiffness;
    if (HAS(TWO_THREADS_RACE)) {
        static volatile double scratch[2];
        scratch[0] = x[1];
        for (volatile int i = 0; i < 20; i++) {}
        result[0] = scratch[0];
        scratch[1] = -damping * x[1] - stiffness * sin(x[0]) + input(d, time);
        for (volatile int i = 0; i < 20; i++) {}
        result[1] = scratch[1];
        return;
    }
    result[0] = x[1];
    result[1] = -damping * x[1] - stiffness * sin(x[0]) + input(d, time);
}

/* One step of the classical Runge-Kutta method. */
static void integrate(const Data *d, double time, double step, double *x) {
    double k1[2], k2[2], k3[2], k4[2], at[2];
    derivatives(d, time, x, k1);
    for (int i = 0; i < 2; i++) at[i] = x[i] + step / 2 * k1[i];
    derivatives(d, time + step / 2, at, k2);
    for (int i = 0; i < 2; i++) at[i] = x[i] + step / 2 * k2[i];
    derivatives(d, time + step / 2, at, k3);
    for (int i = 0; i < 2; i++) at[i] = x[i] + step * k3[i];
    derivatives(d, time + step, at, k4);
    for (int i = 0; i < 2; i++) x[i] += step / 6 * (k1[i] + 2 * k2[i] + 2 * k3[i] + k4[i]);
}

static void restart_integrator(Data *d) {
    d->grid_start = d->now;
    d->grid_steps = 0;
    memcpy(d->grid, d->x, sizeof d->x);
}

static void advance(Data *d, double end) {
    double steps = floor((end - d->grid_start) / STEP + 1e-6);
    for (; d->grid_steps < steps; d->grid_steps++)
        integrate(d, d->grid_start + d->grid_steps * STEP, STEP, d->grid);
    double time = d->grid_start + d->grid_steps * STEP;
    memcpy(d->x, d->grid, sizeof d->x);
    if (end - time > 1e-6 * STEP) integrate(d, time, end - time, d->x);
    d->now = end;
}

static double next_sample(const Data *d) { return d->start + (d->count + 1) * d->period; }

static int sample_is_due(const Data *d, double time) {
    if (HAS(SAMPLE_NEEDS_EXACT_TIME)) return time == next_sample(d);
    return next_sample(d) <= time + TOLERANCE * fmax(1, fabs(time));
}

static void take_sample(Instance *c, Data *d) {
    d->sampled = d->x[0];
    d->count++;
    if (HAS(SAMPLES_OVERFLOW) && d->count <= 16) c->history[d->count] = d->sampled;
    say(c, OK, EVENTS, "sample %d at %g s is %g", d->count, d->now, d->sampled);
}

/* Computes what the initial values determine. */
static void initialise(Data *d) {
    d->sampled = d->x[0];
    d->above = d->x[0] > 0;
    d->count = 0;
    d->u_time = d->now;
    restart_integrator(d);
}

static double power(const Data *d) {
    double x = d->x[0];
    return d->shape == CUBIC ? x * x * x : d->shape == QUADRATIC ? x * x : x;
}

static double power_slope(const Data *d) {
    double x = d->x[0];
    return d->shape == CUBIC ? 3 * x * x : d->shape == QUADRATIC ? 2 * x : 1;
}

static double distort_y(Instance *c, const Data *d, double y) {
    if (HAS(NAN_OUTPUT) && d->now > d->start) return NAN;
    if (HAS(NAN_OUTLIVES_RESET) && c->has_seen_nan) return y + 0.1;
    if (HAS(NAN_OUTPUT_LATE) && d->now > d->start + 1.5) return NAN;
    if (HAS(INFINITE_OUTPUT) && d->now > d->start + 0.5) return INFINITY;
    if (HAS(SECOND_THREAD_WRONG)) return y * thread_gain;
    if (HAS(DEPENDS_ON_ADDRESS)) return y + 1e-3 * ((uintptr_t)c >> 12 & 0xff);
    if (HAS(DEPENDS_ON_RANDOM)) return y + 1e-3 * (double)rand() / RAND_MAX;
    if (HAS(DEPENDS_ON_LOGGING)) return y + 1e-3 * c->logging;
    if (HAS(DEPENDS_ON_ENVIRONMENT)) {
        char folder[PATH_MAX];
        return getcwd(folder, sizeof folder) ? y + 1e-3 * strlen(folder) : y;
    }
    if (HAS(UNINITIALISED_FIELD)) return y + 1e-3 * ((int)c->never_set & 0xff);
    if (HAS(UNINITIALISED_REAL)) return y + c->never_set;
    if (HAS(DEPENDS_ON_WALL_CLOCK)) {
        struct timespec clock;
        clock_gettime(CLOCK_REALTIME, &clock);
        return y + 1e-3 * (clock.tv_nsec / 1000 % 1000);
    }
    if (HAS(STEP_AFTER_ERROR_WRONG) && c->failed) return 0;
    if (HAS(TERMINATE_LOSES_RESULTS) && c->now.phase == TERMINATED_PHASE) return 0;
    return y;
}

/* Reads a Real variable; returns whether there is one. */
static int read_real(Instance *c, unsigned reference, double *value) {
    const Data *d = &c->now.data;
    if (HAS(OUTPUT_NOT_UPDATED_IN_INIT) && c->now.phase == INITIALIZATION) d = &c->held;
    if (HAS(OUTPUT_STALE) && c->now.phase == STEP_COMPLETE) d = &c->held;
    double rate[2];
    derivatives(d, d->now, d->x, rate);
    double u = input(d, d->now);
    switch (reference) {
    case TIME: *value = c->now.data.now; break;
    case U: *value = input(&c->now.data, c->now.data.now); break;
    case DAMPING: *value = d->damping; break;
    case STIFFNESS: *value = d->stiffness; break;
    case OMEGA:
        *value = sqrt(HAS(CALCULATED_PARAMETER_STALE) ? 4 : d->stiffness);
        if (HAS(CALCULATED_PARAMETER_DRIFTS)) *value += 1e-3 * d->count;
        break;
    case G: *value = d->g + (HAS(CONSTANT_CHANGES) ? 1e-3 * d->count : 0); break;
    case X: *value = d->x[0]; break;
    case V: *value = d->x[1]; break;
    case DER_X: *value = rate[0]; break;
    case DER_V: *value = rate[1]; break;
    case Y:
        if (HAS(OUTPUT_REFUSED)) return 0;
        *value = distort_y(c, d, power(d) + (HAS(FACTOR_NOT_CONSTANT) ? u * u / 4 + u / 2 : u / 2));
        break;
    case ENERGY:
        *value = d->x[1] * d->x[1] / 2 + d->stiffness * (1 - cos(d->x[0]));
        if (HAS(UNDECLARED_DEPENDENCY)) *value += u / 10;
        if (HAS(UNDECLARED_DEPENDENCY_LATE) && d->now > d->start + 0.5) *value += u / 10;
        if (HAS(UNDECLARED_BOOLEAN_DEPENDENCY)) *value += d->b;
        if (HAS(UNDECLARED_INITIAL_DEPENDENCY) && c->now.phase == INITIALIZATION) *value += u / 10;
        break;
    case LIMITED: *value = HAS(OUTPUT_OUTSIDE_MIN_MAX) ? 1.5 * sin(d->x[0]) : sin(d->x[0]); break;
    case SAMPLED: *value = d->sampled; break;
    case PERIOD: *value = d->period; break;
    case N:
        if (!HAS(WRONG_TYPE_REFERENCE_TAKEN)) return 0;
        *value = d->n;
        break;
    default:
        if (!HAS(UNKNOWN_REFERENCE_READ)) return 0;
        *value = 0;
    }
    return 1;
}

static int saturated(long long value) {
    return value > INT_MAX ? INT_MAX : value < INT_MIN ? INT_MIN : (int)value;
}

static int read_integer(Instance *c, unsigned reference, int *value) {
    const Data *d = &c->now.data;
    switch (reference) {
    case N: *value = d->n; break;
    case OFFSET: *value = d->offset; break;
    case COUNT: *value = d->count; break;
    case M: *value = saturated((long long)(HAS(INTEGER_TRUNCATED) ? (short)d->n : d->n) + d->offset); break;
    case SHAPE: *value = d->shape; break;
    case CHOICE: *value = HAS(ENUMERATION_OUT_OF_RANGE) ? 7 : d->shape; break;
    default:
        if (!HAS(UNKNOWN_REFERENCE_READ)) return 0;
        *value = 0;
    }
    return 1;
}

static int read_boolean(Instance *c, unsigned reference, int *value) {
    const Data *d = &c->now.data;
    switch (reference) {
    case B: *value = d->b; break;
    case INVERT: *value = d->invert; break;
    case C: *value = d->b != d->invert; break;
    case ABOVE:
        *value = d->above;
        if (HAS(DISCRETE_CHANGES_IN_CONTINUOUS_TIME)) *value = d->x[0] > 0;
        break;
    default: return 0;
    }
    if (HAS(BOOLEAN_IS_2)) *value *= 2;
    return 1;
}

static int read_string(Instance *c, unsigned reference, const char **value) {
    static char shared[2 * TEXT_SIZE];
    const Data *d = &c->now.data;
    char *echo = HAS(SHARED_STRING_BUFFER) ? shared : c->echo;
    switch (reference) {
    case LABEL: *value = d->label; break;
    case TEXT: *value = d->text; break;
    case ECHO:
        snprintf(echo, sizeof c->echo, "%s/%s", d->label, HAS(STRING_INPUT_IGNORED) ? "a" : d->text);
        *value = echo;
        if (HAS(STRING_NULL)) *value = NULL;
        if (HAS(STRING_NOT_UTF8)) *value = "caf\xe9";
        if (HAS(STRING_FREED_TOO_EARLY)) {
            char *volatile copy = strdup(echo);
            *value = copy;
            free(copy);
        }
        break;
    default: return 0;
    }
    return 1;
}

static void write_real(Data *d, unsigned reference, double value) {
    if (HAS(REAL_TRUNCATED)) value = (float)value;
    switch (reference) {
    case U:
        if (value == d->u[0] && d->u[1] == 0 && d->u[2] == 0) return;
        if (d->u_time != d->now) d->u[1] = d->u[2] = 0;
        d->u_time = d->now;
        d->u[0] = value;
        if (HAS(SHARED_STATIC)) shared_torque = value;
        break;
    case DAMPING: d->damping = value; break;
    case STIFFNESS:
        if (value == d->stiffness || (HAS(TUNABLE_IGNORED_LATER) && d->now > d->start)) return;
        d->stiffness = value;
        break;
    case G: d->g = value; return;
    case X: d->x[0] = value; break;
    case V: d->x[1] = value; break;
    case PERIOD: d->period = value; break;
    default: return;
    }
    restart_integrator(d);
}

static void write_integer(Data *d, unsigned reference, int value) {
    if (reference == N) d->n = value;
    else if (reference == OFFSET) d->offset = value;
    else if (reference == SHAPE) d->shape = value;
}

static void write_boolean(Data *d, unsigned reference, int value) {
    if (reference == B) d->b = value;
    else if (reference == INVERT) d->invert = value;
}

static void set_start_values(Data *d) {
    Data old = *d;
    memset(d, 0, sizeof *d);
    if (HAS(SHARED_STATIC)) shared_torque = 0;
    d->damping = 0.3;
    d->stiffness = 4;
    d->period = 0.1;
    d->g = 9.81;
    d->x[0] = HAS(WRONG_START) ? 1.5 : 1;
    d->offset = 3;
    d->shape = LINEAR;
    strcpy(d->label, "run");
    strcpy(d->text, "a");
    if (HAS(RESET_KEEPS_STATE) && old.period > 0) memcpy(d->x, old.x, sizeof d->x);
    if (HAS(RESET_KEEPS_INPUT)) memcpy(d->u, old.u, sizeof d->u);
    if (HAS(RESET_KEEPS_STRING) && *old.text) strcpy(d->text, old.text);
    if (HAS(RESET_KEEPS_PARAMETERS) && old.period > 0) {
        d->damping = old.damping;
        d->stiffness = old.stiffness;
        d->offset = old.offset;
    }
}

/* --- instances ------------------------------------------------------------------------------------ */

EXPORT const char *fmi2GetTypesPlatform(void) { return HAS(WRONG_PLATFORM) ? "other" : "default"; }
EXPORT const char *fmi2GetVersion(void) { return HAS(WRONG_VERSION) ? "1.0" : "2.0"; }

__attribute__((destructor)) static void unload(void) {
    if (HAS(UNLOAD_CRASHES) && instances_made) crash();
    if (HAS(FREES_TWICE_AT_EXIT) && instances_made > 1) {
        void *volatile block = malloc(2000);
        free(block);
        free(block);
    }
}

static void copy_name(Instance *c, const char *name) {
    size_t size = strlen(name) + 1;
    c->name = allocate(c, HAS(LONG_NAME_OVERFLOWS) ? 32 : size);
    if (c->name) memcpy(c->name, name, size);
}

EXPORT Instance *fmi2Instantiate(const char *name, int type, const char *guid, const char *resources,
                                 const Callbacks *functions, int visible, int logging) {
    (void)visible;
    static Instance single;
    if (!name || !*name || !guid || !functions || (type != 0 && type != CO_SIMULATION)) return NULL;
    if (HAS(GUID_REFUSED) || (!HAS(ANY_GUID_TAKEN) && strcmp(guid, GUID))) {
        if (functions->logger && logging)
            functions->logger(functions->environment, name, ERROR, "logStatusError",
                              "the GUID is %s, expected %s", guid, GUID);
        return NULL;
    }
    if (HAS(RESOURCE_PATH_NOT_DECODED) && resources && strchr(resources, '%')) return NULL;
    if (HAS(DEPENDS_ON_RESOURCE_PATH) && strlen(resources) == 0) return NULL;
    if (HAS(SECOND_INSTANCE_REFUSED) && instances_made) return NULL;
    if (HAS(SECOND_INSTANCE_ABORTS) && instances_made) abort();
    if (HAS(EIGHT_INSTANCES_EVER) && instances_made >= 8) return NULL;
    instances_made++;
    Callbacks copy = *functions;
    Instance *c = copy.allocate ? copy.allocate(1, sizeof *c) : calloc(1, sizeof *c);
    if (HAS(UNINITIALISED_FIELD) || HAS(UNINITIALISED_REAL)) {
        c = malloc(sizeof *c);
        double garbage = *(volatile double *)&c->never_set;
        memset(c, 0, sizeof *c);
        c->never_set = garbage;
        copy.release = free;
    }
    if (HAS(ONE_INSTANCE_FOR_ALL)) c = &single;
    if (!c) return NULL;
    c->functions = copy;
    c->kept_functions = functions;
    c->kept_name = name;
    copy_name(c, name);
    if (!c->name) {
        release(c, c);
        return NULL;
    }
    c->logging = logging;
    c->categories = ALL_MESSAGES;
    c->now.phase = INSTANTIATED;
    c->now.model_exchange = type != CO_SIMULATION;
    set_start_values(&c->now.data);
    if (HAS(DEPENDS_ON_INSTANCE_NAME)) c->now.data.damping += 1e-3 * strlen(name);
    if (HAS(DEPENDS_ON_PREVIOUS_INSTANCE)) c->now.data.x[0] += 1e-3 * (instances_made - 1);
    if (HAS(SAMPLES_OVERFLOW)) c->history = malloc(16 * sizeof *c->history);
    if (HAS(LEAK_PER_INSTANCE)) leak(10000);
    if (HAS(LEAK_PER_CALLBACK)) allocate(c, 10000);
    thread_gain = 1;
    change_process(resources);
    return c;
}

static void *log_later(void *argument) {
    Callbacks functions = *(Callbacks *)argument;
    free(argument);
    usleep(50000);
    if (functions.logger) functions.logger(functions.environment, "late", OK, "logAll", "%s", "freed");
    return NULL;
}

EXPORT void fmi2FreeInstance(Instance *c) {
    if (!c && HAS(FREE_NULL_CRASHES)) crash();
    if (!c) return;
    if (HAS(FREE_CRASHES)) crash();
    if (HAS(FREE_LOGS_AFTER)) {
        pthread_t thread;
        Callbacks *functions = malloc(sizeof *functions);
        *functions = c->functions;
        pthread_create(&thread, NULL, log_later, functions);
        pthread_detach(thread);
    }
    if (HAS(SAMPLES_OVERFLOW)) free(c->history);
    release(c, c->name);
    if (HAS(ONE_INSTANCE_FOR_ALL)) return;
    release(c, c);
    if (HAS(WRITES_AFTER_FREE)) *(volatile double *)&c->now.data.x[0] = 0;
}

EXPORT Status fmi2SetDebugLogging(Instance *c, int on, size_t n, const char *const *categories) {
    ALLOWED_IN(c, ALIVE);
    if (HAS(LOGGING_REFUSED)) return ERROR;
    if (n && !categories) REFUSE(c, "fmi2SetDebugLogging: the categories are NULL");
    int chosen = n ? 0 : ALL_MESSAGES;
    for (size_t i = 0; i < n; i++) {
        size_t k = 0;
        while (k < 3 && (!categories[i] || strcmp(categories[i], category_names[k]))) k++;
        if (k == 3 && HAS(UNKNOWN_CATEGORY_CRASHES)) crash();
        if (k == 3) REFUSE(c, "fmi2SetDebugLogging: there is no category %s", categories[i]);
        chosen |= 1 << k;
    }
    c->logging = on || HAS(LOGGING_NEVER_OFF);
    c->categories = chosen;
    return OK;
}

EXPORT Status fmi2SetupExperiment(Instance *c, int tolerance_defined, double tolerance, double start,
                                  int stop_defined, double stop) {
    ALLOWED_IN(c, INSTANTIATED);
    if (tolerance_defined && !(tolerance > 0 && isfinite(tolerance)))
        REFUSE(c, "fmi2SetupExperiment: the tolerance is %g", tolerance);
    if (!isfinite(start)) REFUSE(c, "fmi2SetupExperiment: the start time is %g", start);
    if (stop_defined && !(stop >= start && isfinite(stop)))
        REFUSE(c, "fmi2SetupExperiment: the stop time is %g", stop);
    Data *d = &c->now.data;
    d->tolerance = tolerance_defined ? tolerance : 0;
    d->stop_defined = stop_defined != 0;
    d->stop = stop_defined ? stop : 0;
    if (c->keep_time) return OK;
    d->start = d->now = HAS(START_TIME_IGNORED) ? 0 : start;
    return OK;
}

EXPORT Status fmi2EnterInitializationMode(Instance *c) {
    ALLOWED_IN(c, INSTANTIATED | (HAS(DOUBLE_INIT_TAKEN) ? STEP_COMPLETE | EVENT_MODE : 0));
    if (HAS(HANG_IN_INIT)) hang();
    initialise(&c->now.data);
    c->held = c->now.data;
    c->now.phase = INITIALIZATION;
    return OK;
}

EXPORT Status fmi2ExitInitializationMode(Instance *c) {
    ALLOWED_IN(c, INITIALIZATION);
    c->held = c->now.data;
    c->now.phase = c->now.model_exchange ? EVENT_MODE : STEP_COMPLETE;
    return OK;
}

EXPORT Status fmi2Terminate(Instance *c) {
    ALLOWED_IN(c, RUNNING | STEP_COMPLETE | STEP_FAILED);
    if (HAS(TERMINATE_ABORTS)) abort();
    if (HAS(HANG_IN_TERMINATE)) hang();
    c->now.phase = TERMINATED_PHASE;
    return OK;
}

EXPORT Status fmi2Reset(Instance *c) {
    ALLOWED_IN(c, ALIVE);
    if (HAS(RESET_REFUSED) || (HAS(RESET_AFTER_ERROR_REFUSED) && c->failed)) return ERROR;
    if (HAS(RESET_CRASHES)) crash();
    if (HAS(LEAK_PER_RESET)) leak(1000);
    if (HAS(RESET_KEEPS_TIME) && c->now.data.now > 0) {
        double now = c->now.data.now;
        set_start_values(&c->now.data);
        c->now.data.now = c->now.data.start = now;
        c->keep_time = 1;
    } else {
        set_start_values(&c->now.data);
    }
    c->failed = 0;
    if (!HAS(RESET_KEEPS_PHASE)) c->now.phase = INSTANTIATED;
    return OK;
}

/* --- get and set ---------------------------------------------------------------------------------- */

/* Whether a variable may be set now. */
static int is_settable(const Instance *c, enum Class class, int is_real) {
    int always = INSTANTIATED | INITIALIZATION;
    int later = EVENT_MODE | STEP_COMPLETE;
    int phases = 0;
    switch (class) {
    case INPUT: phases = always | later | (is_real ? CONTINUOUS_TIME : 0); break;
    case TUNABLE: phases = always | (HAS(TUNABLE_REFUSED) ? 0 : later); break;
    case FIXED: phases = always | (HAS(FIXED_PARAMETER_SETTABLE_LATER) ? later : 0); break;
    case STATE: phases = always; break;
    case CALCULATED: phases = 0; break;
    }
    return (c->now.phase & phases) != 0;
}

/* Why a value is not allowed for a variable, or NULL if it is. */
static const char *objection(const Instance *c, const Rule *rules, size_t rule_count, unsigned reference,
                             double value, int is_real) {
    if (reference >= rule_count) return HAS(UNKNOWN_REFERENCE_SET) ? NULL : "there is no such variable";
    const Rule *rule = &rules[reference];
    if (HAS(OUTPUT_SETTABLE) && is_real && reference >= Y && reference <= LIMITED) return NULL;
    if (HAS(CONSTANT_SETTABLE) && is_real && reference == G) return NULL;
    if (!is_settable(c, rule->class, is_real)) return "the variable cannot be set now";
    if (HAS(NAN_TAKEN)) return NULL;
    if (HAS(NO_ITEM_TAKEN) && rules == integer_rules && reference == SHAPE - N) return NULL;
    if (HAS(HANG_ON_NAN) && isnan(value)) hang();
    if (HAS(ABORT_ON_NAN) && isnan(value)) abort();
    if (HAS(CRASH_ON_INF) && isinf(value)) crash();
    if (isnan(value)) ((Instance *)c)->has_seen_nan = 1;
    if (!isfinite(value)) return "the value is not finite";
    if (value < rule->min || value > rule->max) return "the value is out of range";
    if (rules == integer_rules && reference == SHAPE - N && value == 3) return "there is no such item";
    return NULL;
}

/* Called before each get. */
static Status before_get(Instance *c) {
    if (HAS(GET_HAS_SIDE_EFFECTS)) c->now.data.x[0] += 1e-6;
    if (HAS(LEAK_PER_GET)) leak(100);
    const Data *d = &c->now.data;
    if (HAS(PARAMETERS_CLASH) && d->damping != 0.3 && d->stiffness != 4) {
        REFUSE(c, "nothing can be computed with this damping and stiffness");
    }
    return HAS(GET_AFTER_TERMINATE_REFUSED) && c->now.phase == TERMINATED_PHASE ? ERROR : OK;
}

/* Called after each set. */
static void after_set(Instance *c) {
    if (c->now.phase == INITIALIZATION) initialise(&c->now.data);
}

#define CHECK_ARRAYS(c, n, references, values) \
    do { \
        if (HAS(NVR_ZERO_CRASHES) && !(n)) crash(); \
        if ((n) && (!(references) || !(values))) REFUSE(c, "%s: an array is NULL", __func__); \
    } while (0)

#define GET(Type, type, read) \
    EXPORT Status fmi2Get##Type(Instance *c, References references, size_t n, type *values) { \
        ALLOWED_IN(c, READABLE); \
        CHECK_ARRAYS(c, n, references, values); \
        if (before_get(c)) return ERROR; \
        type value; \
        int seen = 0; \
        for (size_t i = 0; i < n; i++) { \
            unsigned reference = references[i]; \
            if (HAS(GET_FIFTH_WRONG) && i == 4) reference = references[0]; \
            if (HAS(GET_ORDER_MATTERS) && i && reference < references[0]) reference = references[0] + i; \
            if (!read(c, reference, &value)) \
                REFUSE(c, "fmi2Get" #Type ": there is no variable %u", references[i]); \
            if (HAS(ALIAS_DIFFERS) && reference == Y && seen++) value = 0; \
            values[i] = value; \
        } \
        if (HAS(GET_WRITES_PAST_END)) memset(&values[n], 0, sizeof values[n]); \
        return OK; \
    }

#define SET(Type, type, write, rules, first, is_real) \
    EXPORT Status fmi2Set##Type(Instance *c, References references, size_t n, const type *values) { \
        ALLOWED_IN(c, INSTANTIATED | INITIALIZATION | EVENT_MODE | STEP_COMPLETE \
                          | (is_real ? CONTINUOUS_TIME : 0)); \
        CHECK_ARRAYS(c, n, references, values); \
        for (size_t i = 0; i < n; i++) { \
            const char *why = objection(c, rules, COUNT_OF(rules), references[i] - first, values[i], is_real); \
            if (why && HAS(SET_ERROR_RETURNS_OK)) return OK; \
            if (why) REFUSE(c, "fmi2Set" #Type ": variable %u: %s", references[i], why); \
            if (HAS(PARTIAL_SET)) write(&c->now.data, references[i], values[i]); \
        } \
        if (HAS(SET_IN_INIT_IGNORED) && c->now.phase == INITIALIZATION) return OK; \
        size_t first_set = HAS(FIRST_SET_DROPPED) && n > 1, end = n - (HAS(LAST_SET_DROPPED) && n > 1); \
        for (size_t i = first_set; i < end; i++) write(&c->now.data, references[i], values[i]); \
        if (HAS(SET_WRITES_ARGUMENT)) memset((type *)values, 0, n * sizeof *values); \
        after_set(c); \
        return OK; \
    }

GET(Real, double, read_real)
GET(Integer, int, read_integer)
GET(Boolean, int, read_boolean)
GET(String, const char *, read_string)
SET(Real, double, write_real, real_rules, 0, 1)
SET(Integer, int, write_integer, integer_rules, N, 0)
SET(Boolean, int, write_boolean, boolean_rules, B, 0)


EXPORT Status fmi2SetString(Instance *c, References references, size_t n, const char *const *values) {
    ALLOWED_IN(c, INSTANTIATED | INITIALIZATION | EVENT_MODE | STEP_COMPLETE);
    CHECK_ARRAYS(c, n, references, values);
    for (size_t i = 0; i < n; i++) {
        const char *why = objection(c, string_rules, COUNT_OF(string_rules), references[i] - LABEL, 0, 0);
        if (!why && !values[i]) why = "the value is NULL";
        if (!why && strlen(values[i]) >= TEXT_SIZE && !HAS(LONG_STRING_OVERFLOWS)) why = "it is too long";
        if (why) REFUSE(c, "fmi2SetString: variable %u: %s", references[i], why);
    }
    for (size_t i = 0; i < n - (HAS(LAST_STRING_DROPPED) && n > 1); i++) {
        char *target = references[i] == LABEL ? c->now.data.label : c->now.data.text;
        memcpy(target, values[i], strlen(values[i]) + 1);
        say(c, OK, EVENTS, "variable %u is \"%s\"", references[i], values[i]);
    }
    after_set(c);
    return OK;
}

/* --- FMU state ------------------------------------------------------------------------------------ */

EXPORT Status fmi2GetFMUstate(Instance *c, void **state) {
    ALLOWED_IN(c, ALIVE);
    if (!state) REFUSE(c, "fmi2GetFMUstate: the argument is NULL");
    if (HAS(GET_STATE_REFUSED)) return ERROR;
    if (HAS(STATE_ALIASES_INSTANCE)) {
        *state = &c->now;
        return OK;
    }
    static Snapshot *shared;
    if (HAS(STATE_SHARED)) {
        if (!shared) shared = calloc(1, sizeof *shared);
        *state = shared;
    }
    if (!*state || HAS(STATE_OVERWRITE_LEAKS)) *state = allocate(c, sizeof(Snapshot));
    if (!*state) REFUSE(c, "fmi2GetFMUstate: out of memory");
    memcpy(*state, &c->now, sizeof(Snapshot));
    return OK;
}

EXPORT Status fmi2SetFMUstate(Instance *c, void *state) {
    ALLOWED_IN(c, ALIVE);
    if (!state) REFUSE(c, "fmi2SetFMUstate: the state is NULL");
    if (HAS(SET_STATE_IGNORED)) return OK;
    Snapshot *saved = state;
    if (saved->model_exchange != c->now.model_exchange) REFUSE(c, "fmi2SetFMUstate: another kind of FMU");
    Snapshot old = c->now;
    memmove(&c->now, saved, sizeof c->now);
    Data *d = &c->now.data, *lost = &old.data;
    if (HAS(STATE_LOSES_PHASE)) c->now.phase = old.phase;
    if (HAS(STATE_LOSES_DISCRETE)) d->count = lost->count, d->sampled = lost->sampled;
    if (HAS(STATE_LOSES_CONTINUOUS)) d->x[1] = lost->x[1], d->grid[1] = lost->x[1];
    if (HAS(STATE_LOSES_TIME)) d->now = lost->now, d->grid_start += lost->now - saved->data.now;
    if (HAS(STATE_LOSES_PARAMETER)) d->stiffness = lost->stiffness;
    if (HAS(STATE_LOSES_INPUT)) memcpy(d->u, lost->u, sizeof d->u), d->u_time = d->now;
    if (HAS(STATE_LOSES_STRING)) strcpy(d->text, lost->text);
    if (HAS(STATE_USED_UP)) memset(saved, 0, sizeof *saved);
    c->held = *d;
    c->failed = 0;
    return OK;
}

EXPORT Status fmi2FreeFMUstate(Instance *c, void **state) {
    ALLOWED_IN(c, ALIVE);
    if (HAS(FREE_STATE_NULL_CRASHES) && (!state || !*state)) crash();
    if (!state || !*state) return OK;
    if (!HAS(STATE_ALIASES_INSTANCE) && !HAS(STATE_SHARED) && !HAS(FREE_STATE_LEAKS)) release(c, *state);
    if (!HAS(FREE_STATE_KEEPS_POINTER)) *state = NULL;
    return OK;
}

enum { SERIALIZED_SIZE = sizeof(Header) + sizeof(Snapshot) };

static uint64_t checksum(const void *bytes, size_t size) {
    uint64_t hash = 0xcbf29ce484222325;
    for (size_t i = 0; i < size; i++) hash = (hash ^ ((const unsigned char *)bytes)[i]) * 0x100000001b3;
    return hash;
}

EXPORT Status fmi2SerializedFMUstateSize(Instance *c, void *state, size_t *size) {
    ALLOWED_IN(c, ALIVE);
    if (!state || !size) REFUSE(c, "fmi2SerializedFMUstateSize: an argument is NULL");
    *size = SERIALIZED_SIZE - (HAS(STATE_SIZE_TOO_SMALL) ? 64 : 0);
    if (HAS(STATE_SIZE_HUGE)) *size = (size_t)-1;
    return OK;
}

EXPORT Status fmi2SerializeFMUstate(Instance *c, void *state, char *bytes, size_t size) {
    static uint32_t calls;
    ALLOWED_IN(c, ALIVE);
    if (!state || !bytes) REFUSE(c, "fmi2SerializeFMUstate: an argument is NULL");
    if (size < SERIALIZED_SIZE && !HAS(STATE_SIZE_TOO_SMALL))
        REFUSE(c, "fmi2SerializeFMUstate: %zu bytes, expected %d", size, SERIALIZED_SIZE);
    if (HAS(SERIALIZE_WRITES_NOTHING)) return OK;
    Header header = {"FMUstate", SERIALIZED_SIZE, 0, checksum(state, sizeof(Snapshot))};
    if (HAS(STATE_BYTES_DIFFER)) header.reserved = ++calls;
    memcpy(bytes, &header, sizeof header);
    memcpy(bytes + sizeof header, state, sizeof(Snapshot));
    if (HAS(STATE_HOLDS_POINTER)) memcpy(bytes + sizeof header, &state, sizeof state);
    return OK;
}

EXPORT Status fmi2DeSerializeFMUstate(Instance *c, const char *bytes, size_t size, void **state) {
    ALLOWED_IN(c, ALIVE);
    if (!state || !bytes) REFUSE(c, "fmi2DeSerializeFMUstate: an argument is NULL");
    static char padded[SERIALIZED_SIZE];
    if (HAS(TRUNCATED_STATE_TAKEN) && size < SERIALIZED_SIZE) {
        memset(padded, 0, sizeof padded);
        memcpy(padded, bytes, size);
        bytes = padded;
    } else if (size != SERIALIZED_SIZE && !HAS(STATE_SIZE_TOO_SMALL)) {
        REFUSE(c, "fmi2DeSerializeFMUstate: %zu bytes, expected %d", size, SERIALIZED_SIZE);
    }
    int unchecked = HAS(DAMAGED_STATE_TAKEN) || HAS(TRUNCATED_STATE_TAKEN) || HAS(STATE_HOLDS_POINTER)
                    || HAS(STATE_SIZE_TOO_SMALL) || HAS(SERIALIZE_WRITES_NOTHING);
    Header header;
    memcpy(&header, bytes, sizeof header);
    int damaged = memcmp(header.magic, "FMUstate", 8) || header.size != SERIALIZED_SIZE
                  || (header.reserved && !HAS(STATE_BYTES_DIFFER))
                  || header.checksum != checksum(bytes + sizeof header, sizeof(Snapshot));
    if (damaged && HAS(DAMAGED_STATE_CRASHES)) crash();
    if (damaged && !unchecked) REFUSE(c, "fmi2DeSerializeFMUstate: the bytes are damaged");
    const void *source = bytes + sizeof header;
    if (HAS(STATE_HOLDS_POINTER)) memcpy(&source, bytes + sizeof header, sizeof source);
    if (!*state) *state = allocate(c, sizeof(Snapshot));
    if (!*state) REFUSE(c, "fmi2DeSerializeFMUstate: out of memory");
    memcpy(*state, source, HAS(STATE_SIZE_TOO_SMALL) ? size - sizeof header : sizeof(Snapshot));
    if (HAS(STATE_BYTES_LOSE_PARAMETER)) ((Snapshot *)*state)->data.damping = 0.3;
    return OK;
}

/* --- derivatives ---------------------------------------------------------------------------------- */

/* The partial derivative of an unknown with respect to a known; returns whether both are known. */
static int partial_derivative(const Instance *c, unsigned unknown, unsigned known, double *result) {
    const Data *d = &c->now.data;
    double x = d->x[0], v = d->x[1];
    int initial = c->now.phase == INITIALIZATION;
    if (HAS(INITIAL_DERIVATIVES_REFUSED) && initial) return 0;
    if (known != X && known != V && known != U && !(initial && (known == STIFFNESS || known == DAMPING)))
        return 0;
    *result = 0;
    switch (unknown) {
    case DER_X: *result = known == V; break;
    case DER_V:
        if (known == X) *result = -d->stiffness * cos(x);
        if (HAS(WRONG_DIRECTIONAL_DERIVATIVE) || (HAS(WRONG_DIRECTIONAL_DERIVATIVE_BELOW) && x < -0.5)
            || (HAS(WRONG_DIRECTIONAL_DERIVATIVE_LATE) && d->now > d->start + 0.5))
            *result = -*result;
        if (known == V) *result = -d->damping;
        if (known == U) *result = 1;
        if (known == STIFFNESS) *result = -sin(x);
        if (known == DAMPING) *result = -v;
        break;
    case Y: *result = known == X ? power_slope(d) : known == U ? 0.5 : 0; break;
    case ENERGY:
        *result = known == X ? d->stiffness * sin(x) : known == V ? v : known == STIFFNESS ? 1 - cos(x) : 0;
        break;
    case LIMITED: *result = known == X ? cos(x) : 0; break;
    case SAMPLED: *result = initial && known == X; break;
    case OMEGA: *result = known == STIFFNESS ? 0.5 / sqrt(d->stiffness) : 0; break;
    default: return 0;
    }
    if (HAS(UNLISTED_DERIVATIVE) && unknown == ENERGY && known == U) *result = 1e-6;
    return 1;
}

EXPORT Status fmi2GetDirectionalDerivative(Instance *c, References unknowns, size_t n, References knowns,
                                           size_t m, const double *seed, double *values) {
    ALLOWED_IN(c, READABLE);
    CHECK_ARRAYS(c, n, unknowns, values);
    CHECK_ARRAYS(c, m, knowns, seed);
    if (HAS(DIRECTIONAL_DERIVATIVE_REFUSED)) return ERROR;
    double partial;
    for (size_t i = 0; i < n; i++)
        for (size_t k = 0; k < m; k++)
            if (!partial_derivative(c, unknowns[i], knowns[k], &partial))
                REFUSE(c, "fmi2GetDirectionalDerivative: no derivative of %u with respect to %u",
                       unknowns[i], knowns[k]);
    for (size_t i = 0; i < n; i++) {
        values[i] = 0;
        for (size_t k = 0; k < m; k++) {
            partial_derivative(c, unknowns[i], knowns[k], &partial);
            values[i] += HAS(SEED_IGNORED) ? partial : partial * seed[k];
        }
    }
    return OK;
}

/* --- co-simulation -------------------------------------------------------------------------------- */

EXPORT Status fmi2SetRealInputDerivatives(Instance *c, References references, size_t n, const int *orders,
                                          const double *values) {
    ALLOWED_IN(c, INSTANTIATED | INITIALIZATION | STEP_COMPLETE);
    CHECK_ARRAYS(c, n, references, values);
    if (HAS(INPUT_DERIVATIVE_REFUSED) || c->now.model_exchange) REFUSE(c, "%s is refused", __func__);
    for (size_t i = 0; i < n; i++) {
        if (references[i] != U) REFUSE(c, "%s: %u is not a Real input", __func__, references[i]);
        if (!orders || orders[i] < 1 || orders[i] > 2) REFUSE(c, "%s: the order is not 1 or 2", __func__);
        if (!isfinite(values[i])) REFUSE(c, "%s: the value is %g", __func__, values[i]);
    }
    Data *d = &c->now.data;
    for (size_t i = 0; i < n && !HAS(INPUT_DERIVATIVE_IGNORED); i++) {
        if (values[i] == d->u[orders[i]] && (values[i] == 0 || d->u_time == d->now)) continue;
        if (d->u_time != d->now) {
            d->u[0] = input(d, d->now);
            d->u[1] = d->u[2] = 0;
            d->u_time = d->now;
        }
        d->u[orders[i]] = values[i];
        restart_integrator(d);
    }
    return OK;
}

EXPORT Status fmi2GetRealOutputDerivatives(Instance *c, References references, size_t n,
                                           const int *orders, double *values) {
    ALLOWED_IN(c, STEPPED);
    CHECK_ARRAYS(c, n, references, values);
    if (HAS(OUTPUT_DERIVATIVE_REFUSED) || c->now.model_exchange) REFUSE(c, "%s is refused", __func__);
    const Data *d = &c->now.data;
    double rate[2];
    derivatives(d, d->now, d->x, rate);
    for (size_t i = 0; i < n; i++) {
        if (!orders || orders[i] != 1) REFUSE(c, "%s: the order is not 1", __func__);
        double result;
        switch (references[i]) {
        case Y: result = power_slope(d) * rate[0] + input_rate(d, d->now) / 2; break;
        case ENERGY: result = d->stiffness * sin(d->x[0]) * rate[0] + d->x[1] * rate[1]; break;
        case LIMITED: result = cos(d->x[0]) * rate[0]; break;
        case SAMPLED: result = 0; break;
        default: REFUSE(c, "%s: %u is not a Real output", __func__, references[i]);
        }
        int is_wrong = HAS(OUTPUT_DERIVATIVE_WRONG)
                       || (HAS(OUTPUT_DERIVATIVE_WRONG_LATE) && d->now > d->start + 0.5)
                       || (HAS(OUTPUT_DERIVATIVE_WRONG_BELOW) && input(d, d->now) < -0.5);
        values[i] = is_wrong ? -result : result;
    }
    return OK;
}

/* Integrates until `end`, and takes the samples that are due. */
static void run_until(Instance *c, double end) {
    Data *d = &c->now.data;
    while (sample_is_due(d, end)) {
        advance(d, fmin(next_sample(d), end));
        take_sample(c, d);
        if (HAS(ONE_SAMPLE_PER_STEP)) break;
    }
    advance(d, end);
    d->above = d->x[0] > 0;
}

EXPORT Status fmi2DoStep(Instance *c, double time, double step, int no_set_state) {
    (void)no_set_state;
    ALLOWED_IN(c, STEP_COMPLETE | (HAS(STEP_BEFORE_INIT_TAKEN) ? INSTANTIATED : 0)
                      | (HAS(STEP_AFTER_TERMINATE_TAKEN) ? TERMINATED_PHASE : 0));
    Data *d = &c->now.data;
    double end = d->now + step;
    if (!isfinite(time) || !isfinite(step)) {
        if (HAS(HANG_ON_NAN)) hang();
        if (HAS(ABORT_ON_NAN)) abort();
        if (HAS(CRASH_ON_INF)) crash();
        REFUSE(c, "fmi2DoStep: time %g, step %g", time, step);
    }
    if (step < 0 && HAS(NEGATIVE_STEP_TAKEN)) {
        d->now = end;
        return OK;
    }
    if (step == 0 && HAS(STEP_OF_ZERO_CRASHES)) crash();
    if (step < 0) REFUSE(c, "fmi2DoStep: the step is %g s", step);
    if (fabs(time - d->now) > TOLERANCE * fmax(1, fabs(time)) && !HAS(WRONG_TIME_TAKEN))
        REFUSE(c, "fmi2DoStep: the communication point is %g s, expected %g s", time, d->now);
    if (d->stop_defined && end > d->stop + TOLERANCE * fmax(1, fabs(end)) && !HAS(PAST_STOP_TIME_TAKEN))
        REFUSE(c, "fmi2DoStep: %g s is after the stop time", end);
    if (HAS(ONE_STEP_SIZE_ONLY) && fabs(step - 0.01) > TOLERANCE) REFUSE(c, "fmi2DoStep: step %g", step);
    if (HAS(STEP_DISCARDS) || (HAS(DISCARD_THEN_LOST) && time > 1) || step > LONGEST_STEP) {
        if (HAS(DISCARD_THEN_LOST)) memset(d->x, 0, sizeof d->x);
        say(c, DISCARD, ERRORS, "fmi2DoStep: no result for %g s", end);
        c->now.phase = STEP_FAILED;
        return c->last_status = DISCARD;
    }
    c->held = *d;
    disturb_step(end - d->start);
    static _Thread_local int has_stepped;
    if (HAS(STEPS_ON_ONE_THREAD) && !has_stepped && d->now > d->start) return ERROR;
    has_stepped = 1;
    if (HAS(DEPENDS_ON_STEP_SIZE)) {
        double rate[2];
        derivatives(d, d->now, d->x, rate);
        for (int i = 0; i < 2; i++) d->x[i] += step * rate[i];
        restart_integrator(d);
        d->grid_start = end;
    }
    run_until(c, end);
    if (HAS(TINY_STEPS_DRIFT) && step < 1e-9) {
        d->x[0] += 0.01;
        restart_integrator(d);
    }
    if (HAS(FATAL_LATER) && end > 0.5) return FATAL;
    if (HAS(STEP_STATUS_UNKNOWN)) return 77;
    if (HAS(STEP_PENDING)) return PENDING;
    if (HAS(STEP_WARNS)) return WARNING;
    return c->last_status = OK;
}

EXPORT Status fmi2GetRealStatus(Instance *c, int kind, double *value) {
    ALLOWED_IN(c, STEPPED);
    if (HAS(GET_STATUS_CRASHES)) crash();
    if (kind != LAST_SUCCESSFUL_TIME || !value) REFUSE(c, "fmi2GetRealStatus: there is no status %d", kind);
    *value = HAS(LAST_TIME_WRONG) ? 0 : c->now.data.now;
    return OK;
}

EXPORT Status fmi2GetStatus(Instance *c, int kind, Status *value) {
    ALLOWED_IN(c, STEPPED);
    if (kind != 0 || !value) REFUSE(c, "fmi2GetStatus: there is no status %d", kind);
    *value = c->last_status;
    return OK;
}

EXPORT Status fmi2GetBooleanStatus(Instance *c, int kind, int *value) {
    ALLOWED_IN(c, STEPPED);
    if (kind != TERMINATED || !value) REFUSE(c, "fmi2GetBooleanStatus: there is no status %d", kind);
    *value = 0;
    return OK;
}

EXPORT Status fmi2GetStringStatus(Instance *c, int kind, const char **value) {
    ALLOWED_IN(c, STEPPED);
    if (kind != 1 || !value) REFUSE(c, "fmi2GetStringStatus: there is no status %d", kind);
    *value = "";
    return OK;
}

EXPORT Status fmi2GetIntegerStatus(Instance *c, int kind, int *value) {
    (void)value;
    ALLOWED_IN(c, STEPPED);
    REFUSE(c, "fmi2GetIntegerStatus: there is no status %d", kind);
}

#ifndef WITHOUT_CANCEL_STEP
EXPORT Status fmi2CancelStep(Instance *c) {
    if (HAS(CANCEL_STEP_CRASHES)) crash();
    ALLOWED_IN(c, 0);
    return ERROR;
}
#endif

/* --- model exchange ------------------------------------------------------------------------------- */

EXPORT Status fmi2EnterEventMode(Instance *c) {
    ALLOWED_IN(c, RUNNING);
    if (HAS(ENTER_EVENT_MODE_REFUSED)) return ERROR;
    c->now.phase = EVENT_MODE;
    return OK;
}

EXPORT Status fmi2NewDiscreteStates(Instance *c, EventInfo *info) {
    ALLOWED_IN(c, EVENT_MODE);
    if (!info) REFUSE(c, "fmi2NewDiscreteStates: the argument is NULL");
    Data *d = &c->now.data;
    while (sample_is_due(d, d->now)) take_sample(c, d);
    d->above = d->x[0] > 0;
    if (HAS(EVENT_INFO_NOT_WRITTEN)) return OK;
    memset(info, 0, sizeof *info);
    info->new_discrete_states_needed = HAS(NEVER_LEAVES_EVENT_ITERATION);
    info->terminate_simulation = HAS(TERMINATES_SIMULATION) && d->now > d->start + 0.5;
    info->next_event_time_defined = !HAS(NEXT_EVENT_MISSING);
    info->next_event_time = HAS(NEXT_EVENT_IN_PAST) ? d->now - 1 : next_sample(d);
    if (HAS(STATE_CHANGE_NOT_SAID) && d->now > d->start) d->x[1] *= 0.9;
    return OK;
}

EXPORT Status fmi2EnterContinuousTimeMode(Instance *c) {
    ALLOWED_IN(c, EVENT_MODE);
    c->held = c->now.data;
    c->now.phase = CONTINUOUS_TIME;
    return OK;
}

EXPORT Status fmi2CompletedIntegratorStep(Instance *c, int no_set_state, int *enter_event_mode,
                                          int *terminate) {
    (void)no_set_state;
    ALLOWED_IN(c, CONTINUOUS_TIME);
    if (!enter_event_mode || !terminate) REFUSE(c, "fmi2CompletedIntegratorStep: an argument is NULL");
    c->held = c->now.data;
    disturb_step(c->now.data.now - c->now.data.start);
    if (HAS(COMPLETED_STEP_MISSING)) return OK;
    *enter_event_mode = *terminate = 0;
    return OK;
}

EXPORT Status fmi2SetTime(Instance *c, double time) {
    ALLOWED_IN(c, RUNNING);
    Data *d = &c->now.data;
    if (HAS(HANG_ON_NAN) && isnan(time)) hang();
    if (HAS(ABORT_ON_NAN) && isnan(time)) abort();
    if (HAS(CRASH_ON_INF) && isinf(time)) crash();
    if (!isfinite(time)) REFUSE(c, "fmi2SetTime: the time is %g", time);
    if (HAS(TIME_BACK_REFUSED) && time < d->now) REFUSE(c, "fmi2SetTime: the time is %g", time);
    if (HAS(SET_TIME_IGNORED)) return OK;
    d->now = time; /* may be after the stop time: solvers step over it and interpolate */
    return OK;
}

/* Checks the length of an array of continuous states. */
#define CHECK_STATES(c, values, n, expected) \
    do { \
        if ((n) != (expected) && !HAS(WRONG_STATE_COUNT_TAKEN)) \
            REFUSE(c, "%s: %zu values, expected %d", __func__, (n), expected); \
        if (!(values)) REFUSE(c, "%s: the array is NULL", __func__); \
    } while (0)

EXPORT Status fmi2SetContinuousStates(Instance *c, const double *states, size_t n) {
    ALLOWED_IN(c, CONTINUOUS_TIME);
    CHECK_STATES(c, states, n, 2);
    for (int i = 0; i < 2; i++) {
        if (isfinite(states[i]) || HAS(NAN_TAKEN)) continue;
        REFUSE(c, "fmi2SetContinuousStates: the value is %g", states[i]);
    }
    for (int i = 0; i < 2; i++) c->now.data.x[i] = states[HAS(STATES_SWAPPED) ? 1 - i : i];
    return OK;
}

EXPORT Status fmi2GetContinuousStates(Instance *c, double *states, size_t n) {
    ALLOWED_IN(c, INITIALIZATION | RUNNING | TERMINATED_PHASE);
    CHECK_STATES(c, states, n, 2);
    for (int i = 0; i < 2; i++) states[i] = c->now.data.x[HAS(STATES_SWAPPED) ? 1 - i : i];
    if (HAS(THREE_STATES)) *(volatile double *)&states[2] = 0;
    return OK;
}

EXPORT Status fmi2GetDerivatives(Instance *c, double *result, size_t n) {
    ALLOWED_IN(c, INITIALIZATION | RUNNING | TERMINATED_PHASE);
    CHECK_STATES(c, result, n, 2);
    Data *d = &c->now.data;
    if (HAS(DERIVATIVES_HAVE_SIDE_EFFECTS)) d->damping += 1e-4;
    Data used = *d;
    if (HAS(DERIVATIVES_USE_STALE_STATE)) memcpy(used.x, c->held.x, sizeof used.x);
    if (HAS(DERIVATIVES_USE_STALE_INPUT)) memcpy(used.u, c->held.u, sizeof used.u);
    double rate[2];
    derivatives(&used, used.now, used.x, rate);
    if (HAS(WRONG_DERIVATIVE_LATE) && d->now > d->start + 0.5) rate[1] = -rate[1];
    if (HAS(DERIVATIVE_NAN_LATE) && d->now > d->start + 0.5) rate[1] = NAN;
    for (int i = 0; i < 2; i++) result[i] = rate[HAS(DERIVATIVES_SWAPPED) ? 1 - i : i];
    return OK;
}

EXPORT Status fmi2GetEventIndicators(Instance *c, double *indicators, size_t n) {
    ALLOWED_IN(c, INITIALIZATION | RUNNING | TERMINATED_PHASE);
    CHECK_STATES(c, indicators, n, 1);
    indicators[0] = c->now.data.x[0];
    if (HAS(EVENT_INDICATOR_CONSTANT)) indicators[0] = 1;
    if (HAS(EVENT_INDICATOR_NAN)) indicators[0] = NAN;
    if (HAS(EVENT_INDICATOR_CHANGES_ON_READ) && c->reads++ % 2) indicators[0] = -indicators[0];
    return OK;
}

EXPORT Status fmi2GetNominalsOfContinuousStates(Instance *c, double *nominals, size_t n) {
    ALLOWED_IN(c, INSTANTIATED | INITIALIZATION | RUNNING | TERMINATED_PHASE);
    CHECK_STATES(c, nominals, n, 2);
    nominals[0] = HAS(NOMINAL_ZERO) ? 0 : HAS(NOMINAL_NEGATIVE) ? -1 : HAS(NOMINAL_NAN) ? NAN : 1;
    nominals[1] = HAS(NOMINAL_OTHER) ? 3 : 2;
    return OK;
}
