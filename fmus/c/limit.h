/* limit.h - limits a torque to what a drive can deliver. */
#ifndef LIMIT_H
#define LIMIT_H

#include "real.h"

/* `x` within least ... most; NaN stays NaN. */
static inline Real clipped(Real x, Real least, Real most)
{
    return PICK(x > most, most, PICK(x < least, least, x));
}

/* `tau` within -limit ... limit; NaN stays NaN. */
static inline Real limited(Real tau, Real limit) { return clipped(tau, -limit, limit); }

/* The message of a law whose values are not finite. */
#define LAW_DIVERGED "the law left the range of numbers (|q| <= 1e6 rad): the motion or the estimate diverged"

#endif
