/* The sources of Decay for FMI 2.0 in one file. */
#define FMI_VERSION 2
#define RATE 1

#include "decay.c"
#include "derivative.c"
