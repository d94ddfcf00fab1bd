/* limit.h - a torque within what a drive gives. */
#ifndef LIMIT_H
#define LIMIT_H

/* `tau` within -limit ... limit; NaN stays NaN. */
static inline double limited(double tau, double limit) {
    return tau > limit ? limit : tau < -limit ? -limit : tau;
}

/* What a law reports whose values are no finite numbers any more. */
#define LAW_DIVERGED \
    "the law left the range of numbers (|q| <= 1e6 rad): the motion or the estimate diverged"

#endif
