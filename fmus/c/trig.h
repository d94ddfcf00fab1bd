/* trig.h - sine and cosine that are the same on every machine: no libm, no fused operations. */
#ifndef TRIG_H
#define TRIG_H

/* sin x and cos x of x in rad, to about 1 ulp; |x| <= TRIG_RANGE, both NaN beyond. */
#define TRIG_RANGE 1048576.0
#define TRIG_ROUND 0x1.8p52 /* adding and subtracting it rounds to an integer */

void sine_cosine(double x, double *sine, double *cosine);

#endif
