/* For FMI 3.0, a file of its own with its own options; for FMI 2.0, a part of all.c. */
#include "decay.h"

#if RATE != 1
#error "RATE is not defined as the build description says"
#endif

double derivative(double x, double k) {
    return -(k * x);
}
