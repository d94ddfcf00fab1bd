/* hyperbolic.h - the hyperbolic tangent, the same on every machine: no libm, no fused operations. */
#ifndef HYPERBOLIC_H
#define HYPERBOLIC_H

/* tanh x to about 2 ulp, for every x; NaN of NaN. */
double hyperbolic_tangent(double x);

#endif
