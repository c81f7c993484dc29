/* A PID controller as an FMI 2.0 co-simulation FMU in plain C, with the law of `pendulum_control::Pid`.
 *
 *     e = r - (y + d)
 *     u_p = kp e + kd (e - e_before)/ts + ki sum(e ts),    u = u_p limited to -u_max .. u_max
 *
 * Every fmi2DoStep takes one sample, so the communication step must be ts. */

#include <stddef.h>
#include <stdlib.h>
#include <string.h>

/* --- declarations of FMI 2.0 ------------------------------------------------------------------ */

typedef void *fmi2Component;
typedef void *fmi2FMUstate;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer;
typedef int fmi2Boolean;
typedef char fmi2Char;
typedef char fmi2Byte;
typedef const fmi2Char *fmi2String;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef int fmi2StatusKind;

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

/* --- the controller --------------------------------------------------------------------------- */

#define GUID "{6f1c1a52-8d0b-4a0e-9c39-2f5e2f1d7a40}"

/* Value references, as in modelDescription.xml. */
enum { R, Y, D, U, U_P, E, KP, KI, KD, U_MAX, TS };

typedef struct {
    double r, y, d;
    double u, u_p, e;
    double kp, ki, kd, u_max, ts;
    double sum; /* of e ts */
} Pid;

static void start(Pid *pid) {
    *pid = (Pid){.kp = 300, .ki = 500, .kd = 100, .u_max = 100, .ts = 0.001};
}

static void sample(Pid *pid) {
    double e_before = pid->e;
    pid->e = pid->r - (pid->y + pid->d);
    double rate = (pid->e - e_before) / pid->ts;
    pid->sum += pid->e * pid->ts;
    pid->u_p = pid->kp * pid->e + pid->kd * rate + pid->ki * pid->sum;
    if (pid->u_p > pid->u_max)
        pid->u = pid->u_max;
    else if (pid->u_p < -pid->u_max)
        pid->u = -pid->u_max;
    else
        pid->u = pid->u_p;
}

/* --- life cycle ------------------------------------------------------------------------------- */

EXPORT fmi2String fmi2GetTypesPlatform(void) { return "default"; }

EXPORT fmi2String fmi2GetVersion(void) { return "2.0"; }

EXPORT fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid,
                                     fmi2String resources, const void *callbacks,
                                     fmi2Boolean visible, fmi2Boolean logging) {
    (void)resources, (void)callbacks, (void)visible, (void)logging;
    if (!name || !*name || type != fmi2CoSimulation || !guid || strcmp(guid, GUID)) return NULL;
    Pid *pid = calloc(1, sizeof *pid);
    if (pid) start(pid);
    return pid;
}

EXPORT void fmi2FreeInstance(fmi2Component c) { free(c); }

EXPORT fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n,
                                      const fmi2String categories[]) {
    (void)on, (void)n, (void)categories;
    return c ? fmi2OK : fmi2Error;
}

EXPORT fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_defined,
                                      fmi2Real tolerance, fmi2Real start_time,
                                      fmi2Boolean stop_defined, fmi2Real stop_time) {
    (void)tolerance_defined, (void)tolerance, (void)start_time, (void)stop_defined, (void)stop_time;
    return c ? fmi2OK : fmi2Error;
}

EXPORT fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return c ? fmi2OK : fmi2Error; }

EXPORT fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return c ? fmi2OK : fmi2Error; }

EXPORT fmi2Status fmi2Terminate(fmi2Component c) { return c ? fmi2OK : fmi2Error; }

EXPORT fmi2Status fmi2Reset(fmi2Component c) {
    if (!c) return fmi2Error;
    start(c);
    return fmi2OK;
}

/* --- variables -------------------------------------------------------------------------------- */

EXPORT fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference references[], size_t n,
                              fmi2Real values[]) {
    const Pid *pid = c;
    if (!pid) return fmi2Error;
    for (size_t i = 0; i < n; i++) {
        switch (references[i]) {
            case R: values[i] = pid->r; break;
            case Y: values[i] = pid->y; break;
            case D: values[i] = pid->d; break;
            case U: values[i] = pid->u; break;
            case U_P: values[i] = pid->u_p; break;
            case E: values[i] = pid->e; break;
            case KP: values[i] = pid->kp; break;
            case KI: values[i] = pid->ki; break;
            case KD: values[i] = pid->kd; break;
            case U_MAX: values[i] = pid->u_max; break;
            case TS: values[i] = pid->ts; break;
            default: return fmi2Error;
        }
    }
    return fmi2OK;
}

EXPORT fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference references[], size_t n,
                              const fmi2Real values[]) {
    Pid *pid = c;
    if (!pid) return fmi2Error;
    for (size_t i = 0; i < n; i++) {
        switch (references[i]) {
            case R: pid->r = values[i]; break;
            case Y: pid->y = values[i]; break;
            case D: pid->d = values[i]; break;
            case KP: pid->kp = values[i]; break;
            case KI: pid->ki = values[i]; break;
            case KD: pid->kd = values[i]; break;
            case U_MAX: pid->u_max = values[i]; break;
            case TS: pid->ts = values[i]; break;
            default: return fmi2Error;
        }
    }
    return fmi2OK;
}

/* There are no variables of other types, so only an empty list of references is valid. */
#define NO_VARIABLES(name, type)                                                                  \
    EXPORT fmi2Status name(fmi2Component c, const fmi2ValueReference references[], size_t n,      \
                           type values[]) {                                                       \
        (void)references, (void)values;                                                           \
        return c && n == 0 ? fmi2OK : fmi2Error;                                                  \
    }

NO_VARIABLES(fmi2GetInteger, fmi2Integer)
NO_VARIABLES(fmi2GetBoolean, fmi2Boolean)
NO_VARIABLES(fmi2GetString, fmi2String)
NO_VARIABLES(fmi2SetInteger, const fmi2Integer)
NO_VARIABLES(fmi2SetBoolean, const fmi2Boolean)
NO_VARIABLES(fmi2SetString, const fmi2String)

/* --- steps ------------------------------------------------------------------------------------ */

EXPORT fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real step,
                             fmi2Boolean no_set_state_before) {
    (void)time, (void)no_set_state_before;
    if (!c) return fmi2Error;
    if (step > 0) sample(c);
    return fmi2OK;
}

/* --- functions without a capability flag in modelDescription.xml ------------------------------- */

#define UNSUPPORTED(name, ...)                                                                    \
    EXPORT fmi2Status name(__VA_ARGS__) { return fmi2Error; }

#define ANY(type, name) __attribute__((unused)) type name

UNSUPPORTED(fmi2CancelStep, ANY(fmi2Component, c))
UNSUPPORTED(fmi2GetStatus, ANY(fmi2Component, c), ANY(fmi2StatusKind, kind),
            ANY(fmi2Status *, value))
UNSUPPORTED(fmi2GetRealStatus, ANY(fmi2Component, c), ANY(fmi2StatusKind, kind),
            ANY(fmi2Real *, value))
UNSUPPORTED(fmi2GetIntegerStatus, ANY(fmi2Component, c), ANY(fmi2StatusKind, kind),
            ANY(fmi2Integer *, value))
UNSUPPORTED(fmi2GetBooleanStatus, ANY(fmi2Component, c), ANY(fmi2StatusKind, kind),
            ANY(fmi2Boolean *, value))
UNSUPPORTED(fmi2GetStringStatus, ANY(fmi2Component, c), ANY(fmi2StatusKind, kind),
            ANY(fmi2String *, value))
UNSUPPORTED(fmi2GetFMUstate, ANY(fmi2Component, c), ANY(fmi2FMUstate *, state))
UNSUPPORTED(fmi2SetFMUstate, ANY(fmi2Component, c), ANY(fmi2FMUstate, state))
UNSUPPORTED(fmi2FreeFMUstate, ANY(fmi2Component, c), ANY(fmi2FMUstate *, state))
UNSUPPORTED(fmi2SerializedFMUstateSize, ANY(fmi2Component, c), ANY(fmi2FMUstate, state),
            ANY(size_t *, size))
UNSUPPORTED(fmi2SerializeFMUstate, ANY(fmi2Component, c), ANY(fmi2FMUstate, state),
            ANY(fmi2Byte *, bytes), ANY(size_t, size))
UNSUPPORTED(fmi2DeSerializeFMUstate, ANY(fmi2Component, c), ANY(const fmi2Byte *, bytes),
            ANY(size_t, size), ANY(fmi2FMUstate *, state))
UNSUPPORTED(fmi2GetDirectionalDerivative, ANY(fmi2Component, c),
            ANY(const fmi2ValueReference *, unknowns), ANY(size_t, n_unknowns),
            ANY(const fmi2ValueReference *, knowns), ANY(size_t, n_knowns),
            ANY(const fmi2Real *, direction), ANY(fmi2Real *, derivatives))
UNSUPPORTED(fmi2SetRealInputDerivatives, ANY(fmi2Component, c),
            ANY(const fmi2ValueReference *, references), ANY(size_t, n),
            ANY(const fmi2Integer *, orders), ANY(const fmi2Real *, values))
UNSUPPORTED(fmi2GetRealOutputDerivatives, ANY(fmi2Component, c),
            ANY(const fmi2ValueReference *, references), ANY(size_t, n),
            ANY(const fmi2Integer *, orders), ANY(fmi2Real *, values))
