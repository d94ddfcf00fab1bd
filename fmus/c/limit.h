/* limit.h - limits a torque to what a drive can deliver. */
#ifndef LIMIT_H
#define LIMIT_H

/* `tau` within -limit ... limit; NaN stays NaN. */
static inline double limited(double tau, double limit) {
    return tau > limit ? limit : tau < -limit ? -limit : tau;
}

/* The message of a law whose values are not finite. */
#define LAW_DIVERGED \
    "the law left the range of numbers (|q| <= 1e6 rad): the motion or the estimate diverged"

#endif
