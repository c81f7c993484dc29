/* The declarations of FMI 3.0 that the C programs use. */
#ifndef FMI3_H
#define FMI3_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef void *Component; /* an instance, with the name of FMI 2.0, as the scenarios call it */
typedef void *State;
typedef const unsigned *References;
typedef const char *Text;
typedef bool Flag;
typedef enum { OK, WARNING, DISCARD, ERROR, FATAL } Status;

typedef void (*Logger)(void *, Status, const char *, const char *);
typedef void (*IntermediateUpdate)(void *, double, bool, bool, bool, bool, bool *, double *);

enum { MODEL_EXCHANGE, CO_SIMULATION };

/* Functions with the names of FMI 2.0. */
#define GetDerivatives GetContinuousStateDerivatives
#define GetFMUstate GetFMUState
#define SetFMUstate SetFMUState
#define FreeFMUstate FreeFMUState
#define SerializedFMUstateSize SerializedFMUStateSize
#define SerializeFMUstate SerializeFMUState
#define DeSerializeFMUstate DeserializeFMUState

/* The functions that read and set variables of a type. */
#define ACCESS(F, name, type)                                                                     \
    F(Status, Get##name, (Component, References, size_t, type *, size_t))                         \
    F(Status, Set##name, (Component, References, size_t, const type *, size_t))

/* The functions that the host calls: result, name and arguments. */
#define FUNCTIONS(F)                                                                              \
    F(const char *, GetVersion, (void))                                                           \
    F(Status, SetDebugLogging, (Component, bool, size_t, const char *const *))                    \
    F(Component, InstantiateModelExchange,                                                        \
      (const char *, const char *, const char *, bool, bool, void *, Logger))                     \
    F(Component, InstantiateCoSimulation,                                                         \
      (const char *, const char *, const char *, bool, bool, bool, bool, References, size_t,      \
       void *, Logger, IntermediateUpdate))                                                       \
    F(Component, InstantiateScheduledExecution,                                                   \
      (const char *, const char *, const char *, bool, bool, void *, Logger, void (*)(void *),    \
       void (*)(void), void (*)(void)))                                                           \
    F(void, FreeInstance, (Component))                                                            \
    F(Status, EnterInitializationMode, (Component, bool, double, double, bool, double))           \
    F(Status, ExitInitializationMode, (Component))                                                \
    F(Status, EnterEventMode, (Component))                                                        \
    F(Status, Terminate, (Component))                                                             \
    F(Status, Reset, (Component))                                                                 \
    ACCESS(F, Float32, float)                                                                     \
    ACCESS(F, Float64, double)                                                                    \
    ACCESS(F, Int8, int8_t)                                                                       \
    ACCESS(F, UInt8, uint8_t)                                                                     \
    ACCESS(F, Int16, int16_t)                                                                     \
    ACCESS(F, UInt16, uint16_t)                                                                   \
    ACCESS(F, Int32, int32_t)                                                                     \
    ACCESS(F, UInt32, uint32_t)                                                                   \
    ACCESS(F, Int64, int64_t)                                                                     \
    ACCESS(F, UInt64, uint64_t)                                                                   \
    ACCESS(F, Boolean, bool)                                                                      \
    ACCESS(F, String, Text)                                                                       \
    F(Status, GetBinary,                                                                          \
      (Component, References, size_t, size_t *, const unsigned char **, size_t))                  \
    F(Status, SetBinary,                                                                          \
      (Component, References, size_t, const size_t *, const unsigned char *const *, size_t))      \
    F(Status, GetClock, (Component, References, size_t, bool *))                                  \
    F(Status, SetClock, (Component, References, size_t, const bool *))                            \
    F(Status, GetNumberOfVariableDependencies, (Component, unsigned, size_t *))                   \
    F(Status, GetFMUState, (Component, State *))                                                  \
    F(Status, SetFMUState, (Component, State))                                                    \
    F(Status, FreeFMUState, (Component, State *))                                                 \
    F(Status, SerializedFMUStateSize, (Component, State, size_t *))                               \
    F(Status, SerializeFMUState, (Component, State, char *, size_t))                              \
    F(Status, DeserializeFMUState, (Component, const char *, size_t, State *))                    \
    F(Status, GetDirectionalDerivative,                                                           \
      (Component, References, size_t, References, size_t, const double *, size_t, double *,       \
       size_t))                                                                                   \
    F(Status, GetAdjointDerivative,                                                               \
      (Component, References, size_t, References, size_t, const double *, size_t, double *,       \
       size_t))                                                                                   \
    F(Status, EnterConfigurationMode, (Component))                                                \
    F(Status, ExitConfigurationMode, (Component))                                                 \
    F(Status, EvaluateDiscreteStates, (Component))                                                \
    F(Status, UpdateDiscreteStates,                                                               \
      (Component, bool *, bool *, bool *, bool *, bool *, double *))                              \
    F(Status, EnterContinuousTimeMode, (Component))                                               \
    F(Status, CompletedIntegratorStep, (Component, bool, bool *, bool *))                         \
    F(Status, SetTime, (Component, double))                                                       \
    F(Status, SetContinuousStates, (Component, const double *, size_t))                           \
    F(Status, GetContinuousStateDerivatives, (Component, double *, size_t))                       \
    F(Status, GetEventIndicators, (Component, double *, size_t))                                  \
    F(Status, GetContinuousStates, (Component, double *, size_t))                                 \
    F(Status, GetNominalsOfContinuousStates, (Component, double *, size_t))                       \
    F(Status, GetNumberOfEventIndicators, (Component, size_t *))                                  \
    F(Status, GetNumberOfContinuousStates, (Component, size_t *))                                 \
    F(Status, EnterStepMode, (Component))                                                         \
    F(Status, GetOutputDerivatives,                                                               \
      (Component, References, size_t, const int32_t *, double *, size_t))                         \
    F(Status, DoStep, (Component, double, double, bool, bool *, bool *, bool *, double *))        \
    F(Status, ActivateModelPartition, (Component, unsigned, double))

#endif
