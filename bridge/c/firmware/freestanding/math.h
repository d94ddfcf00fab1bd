/* math.h - the part that a node and its controllers use; sqrt is in freestanding.c. */
#ifndef FREESTANDING_MATH_H
#define FREESTANDING_MATH_H

#define NAN __builtin_nanf("")
#define INFINITY __builtin_inff()

double sqrt(double x);
static inline double fabs(double x) { return __builtin_fabs(x); }

#endif
