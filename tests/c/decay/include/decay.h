/* What the sources of Decay share. */
#ifndef DECAY_H
#define DECAY_H

#ifdef __cplusplus
extern "C" {
#endif

/* The derivative of x, whose rate of decay is k. */
double derivative(double x, double k);

#ifdef __cplusplus
}
#endif
#endif
