/* The declarations of FMI 2.0 that the C programs use. */
#ifndef FMI2_H
#define FMI2_H

#include <stddef.h>

typedef void *Component;
typedef void *State;
typedef const unsigned *References;
typedef int Flag;
typedef char Byte;
typedef enum { OK, WARNING, DISCARD, ERROR, FATAL, PENDING } Status;

typedef struct {
    void (*logger)(void *, const char *, Status, const char *, const char *, ...);
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*step_finished)(void *, Status);
    void *environment;
} Callbacks;

enum { MODEL_EXCHANGE, CO_SIMULATION, LAST_SUCCESSFUL_TIME = 2, TERMINATED = 3 };

typedef struct {
    int discrete_states_need_update, terminate, nominals_changed, values_changed;
    int next_event_time_defined;
    double next_event_time;
} Event;

/* The functions that the hosts call: result, name and arguments. */
#define FUNCTIONS(F)                                                                              \
    F(Component, Instantiate,                                                                     \
      (const char *, int, const char *, const char *, const Callbacks *, int, int))               \
    F(void, FreeInstance, (Component))                                                            \
    F(const char *, GetVersion, (void))                                                           \
    F(const char *, GetTypesPlatform, (void))                                                     \
    F(Status, SetDebugLogging, (Component, int, size_t, const char *const *))                     \
    F(Status, SetupExperiment, (Component, int, double, double, int, double))                     \
    F(Status, EnterInitializationMode, (Component))                                               \
    F(Status, ExitInitializationMode, (Component))                                                \
    F(Status, Terminate, (Component))                                                             \
    F(Status, Reset, (Component))                                                                 \
    F(Status, GetReal, (Component, References, size_t, double *))                                 \
    F(Status, GetInteger, (Component, References, size_t, int *))                                 \
    F(Status, GetBoolean, (Component, References, size_t, int *))                                 \
    F(Status, GetString, (Component, References, size_t, const char **))                          \
    F(Status, SetReal, (Component, References, size_t, const double *))                           \
    F(Status, SetInteger, (Component, References, size_t, const int *))                           \
    F(Status, SetBoolean, (Component, References, size_t, const int *))                           \
    F(Status, SetString, (Component, References, size_t, const char *const *))                    \
    F(Status, GetFMUstate, (Component, State *))                                                  \
    F(Status, SetFMUstate, (Component, State))                                                    \
    F(Status, FreeFMUstate, (Component, State *))                                                 \
    F(Status, SerializedFMUstateSize, (Component, State, size_t *))                               \
    F(Status, SerializeFMUstate, (Component, State, char *, size_t))                              \
    F(Status, DeSerializeFMUstate, (Component, const char *, size_t, State *))                    \
    F(Status, GetDirectionalDerivative,                                                           \
      (Component, References, size_t, References, size_t, const double *, double *))              \
    F(Status, SetRealInputDerivatives,                                                            \
      (Component, References, size_t, const int *, const double *))                               \
    F(Status, GetRealOutputDerivatives,                                                           \
      (Component, References, size_t, const int *, double *))                                     \
    F(Status, DoStep, (Component, double, double, int))                                           \
    F(Status, CancelStep, (Component))                                                            \
    F(Status, GetStatus, (Component, int, Status *))                                              \
    F(Status, GetRealStatus, (Component, int, double *))                                          \
    F(Status, GetBooleanStatus, (Component, int, int *))                                          \
    F(Status, GetStringStatus, (Component, int, const char **))                                   \
    F(Status, EnterEventMode, (Component))                                                        \
    F(Status, NewDiscreteStates, (Component, Event *))                                            \
    F(Status, EnterContinuousTimeMode, (Component))                                               \
    F(Status, CompletedIntegratorStep, (Component, int, int *, int *))                            \
    F(Status, SetTime, (Component, double))                                                       \
    F(Status, SetContinuousStates, (Component, const double *, size_t))                           \
    F(Status, GetDerivatives, (Component, double *, size_t))                                      \
    F(Status, GetEventIndicators, (Component, double *, size_t))                                  \
    F(Status, GetContinuousStates, (Component, double *, size_t))                                 \
    F(Status, GetNominalsOfContinuousStates, (Component, double *, size_t))

#endif
