/* trig.c - sine and cosine by reduction to [-pi/4, pi/4] and a polynomial, see trig_reduced.h. */
#include "trig.h"

#include <math.h>

#include "trig_reduced.h"

void sine_cosine(double x, double *sine, double *cosine)
{
    double s, c;
    if (!(x >= -TRIG_RANGE && x <= TRIG_RANGE)) {
        *sine = *cosine = NAN;
        return;
    }
    const int quadrant = (int)(reduced(x, &s, &c) - TRIG_ROUND) & 3;
    const double p = quadrant & 1 ? c : s, q = quadrant & 1 ? s : c;
    *sine = quadrant & 2 ? -p : p;
    *cosine = (quadrant + 1) & 2 ? -q : q;
}
