/* The loop on a computer with an operating system: prints its signals as CSV. */

#include <stdio.h>

#include "loop.h"

void record(const double *signals, size_t n) {
    for (size_t i = 0; i < n; i++) printf("%.17g%c", signals[i], i + 1 < n ? ',' : '\n');
}

void say(const char *message) {
    fprintf(stderr, "%s\n", message);
}
