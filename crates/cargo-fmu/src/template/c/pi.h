/* PI controller with a limited output. */
#ifndef PI_H
#define PI_H

struct pi {
    double kp;       /* proportional gain */
    double ki;       /* integral gain */
    double u_max;    /* limit of the output, both ways */
    double integral; /* state */
};

/* Takes a sample, `ts` seconds after the last: returns the output for the set-point `r` and the measured value `y`. */
double pi_step(struct pi *pi, double r, double y, double ts);

#endif
