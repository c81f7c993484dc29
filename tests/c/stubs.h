/* What the FMUs of the tests export, and the functions that most of them do not offer. */
#ifndef STUBS_H
#define STUBS_H

#include "fmi2.h"

#define EXPORT __attribute__((visibility("default")))

/* A function that returns an error. */
#define STUB(name) \
    EXPORT int name(void) { return ERROR; }

/* FMU state, derivatives, and the status of asynchronous steps. */
#define OPTIONAL_STUBS                                                                            \
    STUB(fmi2GetFMUstate)                                                                         \
    STUB(fmi2SetFMUstate)                                                                         \
    STUB(fmi2FreeFMUstate)                                                                        \
    STUB(fmi2SerializedFMUstateSize)                                                              \
    STUB(fmi2SerializeFMUstate)                                                                   \
    STUB(fmi2DeSerializeFMUstate)                                                                 \
    STUB(fmi2GetDirectionalDerivative)                                                            \
    STUB(fmi2SetRealInputDerivatives)                                                             \
    STUB(fmi2GetRealOutputDerivatives)                                                            \
    STUB(fmi2CancelStep)                                                                          \
    STUB(fmi2GetStatus)                                                                           \
    STUB(fmi2GetRealStatus)                                                                       \
    STUB(fmi2GetIntegerStatus)                                                                    \
    STUB(fmi2GetBooleanStatus)                                                                    \
    STUB(fmi2GetStringStatus)

#endif
