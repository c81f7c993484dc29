// For FMI 3.0, this file is C++11; for FMI 2.0, all.c includes it as C.
#include "decay.h"

#if RATE != 1
#error "RATE is not defined as the build description says"
#endif

double derivative(double x, double k) {
#ifdef __cplusplus
    const auto slope = -(k * x);
    return slope;
#else
    return -(k * x);
#endif
}
