/* limit.h - a torque within what a drive gives. */
#ifndef LIMIT_H
#define LIMIT_H

/* `tau` within -limit ... limit; NaN stays NaN. */
static inline double limited(double tau, double limit) {
    return tau > limit ? limit : tau < -limit ? -limit : tau;
}

#endif
