#include "pi.h"

double pi_step(struct pi *pi, double r, double y, double ts)
{
    double error = r - y;
    double integral = pi->integral + pi->ki * ts * error;
    double u = pi->kp * error + integral;

    if (u > pi->u_max) {
        return pi->u_max;
    }
    if (u < -pi->u_max) {
        return -pi->u_max;
    }
    /* Anti-windup: the integrator is held while the output saturates. */
    pi->integral = integral;
    return u;
}
