/* Decay, an FMU of FMI_VERSION as other tools export it: with the headers of the standard, which the importer has, and
 * a prefix for static linking. Co-simulation takes a step of Euler's method, x + h der(x), from x = 1. */
#include <stdlib.h>

#include "decay.h"

#if FMI_VERSION == 2
#define FMI2_FUNCTION_PREFIX Decay_
#include "fmi2Functions.h"
#define Status fmi2Status
#define Handle fmi2Component
#define Reference fmi2ValueReference
#define Real fmi2Real
#define Boolean fmi2Boolean
#define OK fmi2OK
#define ERROR fmi2Error
#elif FMI_VERSION == 3
#define FMI3_FUNCTION_PREFIX Decay_
#include "fmi3Functions.h"
#define Status fmi3Status
#define Handle fmi3Instance
#define Reference fmi3ValueReference
#define Real fmi3Float64
#define Boolean fmi3Boolean
#define OK fmi3OK
#define ERROR fmi3Error
#else
#error "FMI_VERSION is not defined as the build description says"
#endif

enum { TIME, X, K, COUNT };

typedef struct {
    double values[COUNT];
} Decay;

static Handle create(void) {
    Decay *decay = calloc(1, sizeof *decay);
    if (decay) {
        decay->values[X] = 1;
        decay->values[K] = 1;
    }
    return decay;
}

static Status get(Handle handle, const Reference references[], size_t count, Real values[]) {
    size_t i;
    for (i = 0; i < count; i++) {
        if (references[i] >= COUNT) return ERROR;
        values[i] = ((Decay *)handle)->values[references[i]];
    }
    return OK;
}

static Status set(Handle handle, const Reference references[], size_t count, const Real values[]) {
    size_t i;
    for (i = 0; i < count; i++) {
        if (references[i] != K) return ERROR;
        ((Decay *)handle)->values[K] = values[i];
    }
    return OK;
}

static Status step(Handle handle, Real step) {
    double *values = ((Decay *)handle)->values;
    values[X] += step * derivative(values[X], values[K]);
    values[TIME] += step;
    return OK;
}

#if FMI_VERSION == 2

const char *fmi2GetVersion(void) { return fmi2Version; }
const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type kind, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
    (void)name, (void)kind, (void)guid, (void)resources, (void)functions, (void)visible, (void)logging;
    return create();
}
void fmi2FreeInstance(fmi2Component c) { free(c); }
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean has_stop, fmi2Real stop) {
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop;
    ((Decay *)c)->values[TIME] = start;
    return fmi2OK;
}
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t count, const fmi2String categories[]) {
    (void)c, (void)on, (void)count, (void)categories;
    return fmi2OK;
}
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return (void)c, fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return (void)c, fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component c) { return (void)c, fmi2OK; }
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference references[], size_t count, fmi2Real values[]) {
    return get(c, references, count, values);
}
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference references[], size_t count, const fmi2Real values[]) {
    return set(c, references, count, values);
}
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real size, fmi2Boolean no_set_state) {
    (void)time, (void)no_set_state;
    return step(c, size);
}

#else

const char *fmi3GetVersion(void) { return fmi3Version; }

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean event_mode, fmi3Boolean early_return,
                                         const fmi3ValueReference intermediate[], size_t count,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback update) {
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)event_mode, (void)early_return;
    (void)intermediate, (void)count, (void)environment, (void)log, (void)update;
    return create();
}
void fmi3FreeInstance(fmi3Instance c) { free(c); }
fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t count, const fmi3String categories[]) {
    (void)c, (void)on, (void)count, (void)categories;
    return fmi3OK;
}
fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean has_tolerance, fmi3Float64 tolerance,
                                       fmi3Float64 start, fmi3Boolean has_stop, fmi3Float64 stop) {
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop;
    ((Decay *)c)->values[TIME] = start;
    return fmi3OK;
}
fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { return (void)c, fmi3OK; }
fmi3Status fmi3Terminate(fmi3Instance c) { return (void)c, fmi3OK; }
fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference references[], size_t count, fmi3Float64 values[],
                          size_t size) {
    return size == count ? get(c, references, count, values) : fmi3Error;
}
fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference references[], size_t count,
                          const fmi3Float64 values[], size_t size) {
    return size == count ? set(c, references, count, values) : fmi3Error;
}
fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 time, fmi3Float64 size, fmi3Boolean no_set_state,
                      fmi3Boolean *event, fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *reached) {
    (void)no_set_state;
    *event = *terminate = *early = fmi3False;
    *reached = time + size;
    return step(c, size);
}

#endif
