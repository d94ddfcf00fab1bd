/* trig.h - sine and cosine that are the same on every machine: no libm, no fused operations. */
#ifndef TRIG_H
#define TRIG_H

#include "real.h"

/* sin x and cos x of x in rad, to about 1 ulp; |x| <= TRIG_RANGE, both NaN beyond. */
#define TRIG_RANGE 1048576.0
#define TRIG_ROUND 0x1.8p52 /* adding and subtracting it rounds to an integer */

#if TOGETHER == 1
void sine_cosine(double x, double *sine, double *cosine);
#else
#include <math.h>

#include "trig_reduced.h"

static inline void sine_cosine(Real x, Real *sine, Real *cosine)
{
    const Truth inside = (x >= -TRIG_RANGE) & (x <= TRIG_RANGE);
    Real s, c;
    const Truth quadrant = (Truth)reduced(x, &s, &c); /* in the lowest bits of its fraction */
    const Truth odd = -(quadrant & 1);
    const Truth sign = (quadrant & 2) << 62, cosign = ((quadrant + 1) & 2) << 62;
    *sine = PICK(inside, (Real)((Truth)PICK(odd, c, s) ^ sign), NAN);
    *cosine = PICK(inside, (Real)((Truth)PICK(odd, s, c) ^ cosign), NAN);
}
#endif

#endif
