/* What loop.c needs from the computer that it runs on: pc.c or board.c. */
#ifndef LOOP_H
#define LOOP_H

#include <stddef.h>

/* Takes the signals of a communication point. */
void record(const double *signals, size_t n);

/* Takes a message of an FMU. */
void say(const char *message);

#endif
