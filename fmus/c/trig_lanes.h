/* trig_lanes.h - sine and cosine of lanes, with the bits of trig.c. */
#ifndef TRIG_LANES_H
#define TRIG_LANES_H

#include <math.h>

#include "lanes.h"
#include "trig.h"

#define REAL Lanes
#define TEMPLATE(name) name##_lanes
#define TEMPLATE_INLINE LANES_INLINE
#include "trig_reduced.h"
#undef REAL
#undef TEMPLATE
#undef TEMPLATE_INLINE

/* sin x and cos x of x in rad; |x| <= TRIG_RANGE, both NaN beyond. */
LANES_INLINE void sine_cosine_lanes(Lanes x, Lanes *sine, Lanes *cosine) {
    const Mask inside = (x >= -TRIG_RANGE) & (x <= TRIG_RANGE);
    const Lanes beyond = {NAN, NAN, NAN, NAN};
    Lanes s, c;
    const Mask quadrant = (Mask)reduced_lanes(x, &s, &c); /* in the lowest bits of its fraction */
    const Mask odd = -(quadrant & 1);
    const Mask sign = (quadrant & 2) << 62, cosign = ((quadrant + 1) & 2) << 62;
    *sine = pick(inside, (Lanes)((Mask)pick(odd, c, s) ^ sign), beyond);
    *cosine = pick(inside, (Lanes)((Mask)pick(odd, s, c) ^ cosign), beyond);
}

#endif
