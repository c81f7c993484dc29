/* The declarations of FMI 3.0 that the C programs use, from the headers of the standard. */
#ifndef FMI3_H
#define FMI3_H

#include "fmi3FunctionTypes.h"

typedef fmi3Instance Component; /* with the name of FMI 2.0, as the scenarios call it */
typedef fmi3FMUState State;
typedef const fmi3ValueReference *References;
typedef fmi3String Text;
typedef fmi3Boolean Flag;
typedef fmi3Byte Byte;
typedef fmi3Status Status;

#define OK fmi3OK
#define DISCARD fmi3Discard
#define ERROR fmi3Error
#define FATAL fmi3Fatal

enum { MODEL_EXCHANGE, CO_SIMULATION };

/* Functions with the names of FMI 2.0. */
#define GetDerivatives GetContinuousStateDerivatives
#define GetFMUstate GetFMUState
#define SetFMUstate SetFMUState
#define FreeFMUstate FreeFMUState
#define SerializedFMUstateSize SerializedFMUStateSize
#define SerializeFMUstate SerializeFMUState
#define DeSerializeFMUstate DeserializeFMUState

#define ROW(F, name) F(fmi3##name##TYPE, name, )
#define ACCESS(F, name) ROW(F, Get##name) ROW(F, Set##name)

/* The functions that the host calls: type and name. */
#define FUNCTIONS(F)                                                                              \
    ROW(F, GetVersion) ROW(F, SetDebugLogging) ROW(F, InstantiateModelExchange)                   \
    ROW(F, InstantiateCoSimulation) ROW(F, InstantiateScheduledExecution) ROW(F, FreeInstance)    \
    ROW(F, EnterInitializationMode) ROW(F, ExitInitializationMode) ROW(F, EnterEventMode)         \
    ROW(F, Terminate) ROW(F, Reset) ACCESS(F, Float32) ACCESS(F, Float64) ACCESS(F, Int8)         \
    ACCESS(F, UInt8) ACCESS(F, Int16) ACCESS(F, UInt16) ACCESS(F, Int32) ACCESS(F, UInt32)        \
    ACCESS(F, Int64) ACCESS(F, UInt64) ACCESS(F, Boolean) ACCESS(F, String) ACCESS(F, Binary)     \
    ACCESS(F, Clock) ROW(F, GetNumberOfVariableDependencies) ROW(F, GetFMUState)                  \
    ROW(F, SetFMUState) ROW(F, FreeFMUState) ROW(F, SerializedFMUStateSize)                       \
    ROW(F, SerializeFMUState) ROW(F, DeserializeFMUState) ROW(F, GetDirectionalDerivative)        \
    ROW(F, GetAdjointDerivative) ROW(F, EnterConfigurationMode) ROW(F, ExitConfigurationMode)     \
    ROW(F, EvaluateDiscreteStates) ROW(F, UpdateDiscreteStates) ROW(F, EnterContinuousTimeMode)   \
    ROW(F, CompletedIntegratorStep) ROW(F, SetTime) ROW(F, SetContinuousStates)                   \
    ROW(F, GetContinuousStateDerivatives) ROW(F, GetEventIndicators) ROW(F, GetContinuousStates)  \
    ROW(F, GetNominalsOfContinuousStates) ROW(F, GetNumberOfEventIndicators)                      \
    ROW(F, GetNumberOfContinuousStates) ROW(F, EnterStepMode) ROW(F, GetOutputDerivatives)        \
    ROW(F, DoStep) ROW(F, ActivateModelPartition)

#endif
