/* Several FMUs in one C program: the closed loop of the paper with PID-RBF. It follows a sine for
 * 20 s at 1 ms, as in examples/closed-loop/pid-rbf.toml with source.signal=sine.
 *
 * The functions of each FMU have a prefix, -DFMI3_FUNCTION_PREFIX=PidRbf_ and so on, with which its
 * sources are compiled. */

#include <stdbool.h>
#include <stdint.h>

#include "loop.h"

/* --- the functions of FMI 3.0 that the loop calls --------------------------------------------- */

typedef void *Instance;
typedef uint32_t Reference;
typedef enum { OK, WARNING, DISCARD, ERROR, FATAL } Status;
typedef void Logger(void *environment, Status, const char *category, const char *message);

typedef Instance Instantiate(const char *name, const char *token, const char *resources,
                             bool visible, bool logging_on, bool event_mode, bool early_return,
                             const Reference *intermediate, size_t n_intermediate,
                             void *environment, Logger *, void *intermediate_update);
typedef Status Enter(Instance, bool has_tolerance, double tolerance, double start, bool has_stop,
                     double stop);
typedef Status Exit(Instance);
typedef Status SetBoolean(Instance, const Reference *, size_t n, const bool *, size_t n_values);
typedef Status SetInt64(Instance, const Reference *, size_t n, const int64_t *, size_t n_values);
typedef Status Set(Instance, const Reference *, size_t n, const double *, size_t n_values);
typedef Status Get(Instance, const Reference *, size_t n, double *, size_t n_values);
typedef Status Step(Instance, double time, double step, bool no_state_before, bool *event_needed,
                    bool *terminate, bool *early_return, double *last_time);
typedef void Free(Instance);

typedef struct {
    const char *name;
    Instantiate *instantiate;
    Enter *enter_initialization;
    Exit *exit_initialization;
    SetBoolean *set_boolean;
    SetInt64 *set_int64;
    Set *set;
    Get *get;
    Step *step;
    Free *free;
} Fmu;

/* Declares the functions of an FMU, and a table of them. */
#define FMU(NAME)                                                                                 \
    Instantiate NAME##_fmi3InstantiateCoSimulation;                                               \
    Enter NAME##_fmi3EnterInitializationMode;                                                     \
    Exit NAME##_fmi3ExitInitializationMode;                                                       \
    SetBoolean NAME##_fmi3SetBoolean;                                                             \
    SetInt64 NAME##_fmi3SetInt64;                                                                 \
    Set NAME##_fmi3SetFloat64;                                                                    \
    Get NAME##_fmi3GetFloat64;                                                                    \
    Step NAME##_fmi3DoStep;                                                                       \
    Free NAME##_fmi3FreeInstance;                                                                 \
    static const Fmu NAME = {                                                                     \
        #NAME,                                                                                    \
        NAME##_fmi3InstantiateCoSimulation,                                                       \
        NAME##_fmi3EnterInitializationMode,                                                       \
        NAME##_fmi3ExitInitializationMode,                                                        \
        NAME##_fmi3SetBoolean,                                                                    \
        NAME##_fmi3SetInt64,                                                                      \
        NAME##_fmi3SetFloat64,                                                                    \
        NAME##_fmi3GetFloat64,                                                                    \
        NAME##_fmi3DoStep,                                                                        \
        NAME##_fmi3FreeInstance,                                                                  \
    };

FMU(Source)
FMU(PidRbf)
FMU(Pendulum)

/* --- the signals, and their value references in modelDescription.xml -------------------------- */

typedef struct {
    double r, d;
    double theta, omega, x, v;
    double u, u_p, u_n, e, w[4], h[4];
} Signals;

static const Reference SOURCE_OUTPUTS[] = {0, 1}, SIGNAL[] = {2};
static const Reference PLANT_OUTPUTS[] = {1, 2, 3, 4}, PLANT_INPUTS[] = {0};
static const Reference CONTROLLER_OUTPUTS[] = {3, 4, 13, 5, 15, 31},
                       CONTROLLER_INPUTS[] = {0, 2, 1}, PREVIOUS_SAMPLE_TERMS[] = {11};

/* --- the loop --------------------------------------------------------------------------------- */

static const double STEP = 1e-3; /* [s] */

static Status worst = OK;

/* Remembers the worst status of all calls. */
static void check(Status status) {
    if (status > worst) worst = status;
}

static void log_message(void *environment, Status status, const char *category,
                        const char *message) {
    (void)environment, (void)status, (void)category;
    say(message);
}

static Instance instantiate(const Fmu *fmu, const char *token) {
    Instance instance = fmu->instantiate(fmu->name, token, NULL, false, false, false, false, NULL,
                                         0, NULL, log_message, NULL);
    if (!instance) check(FATAL);
    return instance;
}

/* Initializes an instance at the first sample of the paper. */
static void initialize(const Fmu *fmu, Instance instance) {
    check(fmu->enter_initialization(instance, false, 0, STEP, false, 0));
    check(fmu->exit_initialization(instance));
}

static void step(const Fmu *fmu, Instance instance, double time) {
    bool event_needed, terminate, early_return;
    check(fmu->step(instance, time, STEP, true, &event_needed, &terminate, &early_return, &time));
}

int main(void) {
    Instance source = instantiate(&Source, "{3d874ae2-0250-87af-9e97-8abec0dc88c7}");
    Instance controller = instantiate(&PidRbf, "{8323976a-673f-8a12-ba7f-74c633debdba}");
    Instance plant = instantiate(&Pendulum, "{b7a8e195-25f3-8bd0-9373-e7db99789d76}");
    if (worst > WARNING) return worst;

    const int64_t sine = 2;
    const bool as_in_table_1 = true;
    check(Source.set_int64(source, SIGNAL, 1, &sine, 1));
    check(PidRbf.set_boolean(controller, PREVIOUS_SAMPLE_TERMS, 1, &as_in_table_1, 1));
    initialize(&Source, source);
    initialize(&PidRbf, controller);
    initialize(&Pendulum, plant);

    for (int k = 0; k < 20000 && worst <= WARNING; k++) {
        double time = STEP + k * STEP;
        Signals now;
        check(Source.get(source, SOURCE_OUTPUTS, 2, &now.r, 2));
        check(Pendulum.get(plant, PLANT_OUTPUTS, 4, &now.theta, 4));

        double inputs[] = {now.r, now.d, now.theta};
        check(PidRbf.set(controller, CONTROLLER_INPUTS, 3, inputs, 3));
        step(&PidRbf, controller, time);
        check(PidRbf.get(controller, CONTROLLER_OUTPUTS, 6, &now.u, 12));

        check(Pendulum.set(plant, PLANT_INPUTS, 1, &now.u, 1));
        step(&Pendulum, plant, time);
        step(&Source, source, time);
        record(&now.r, sizeof now / sizeof(double));
    }

    Source.free(source);
    PidRbf.free(controller);
    Pendulum.free(plant);
    return worst;
}
