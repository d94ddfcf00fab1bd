/* wide.h - steps of several instances at once, and which of them there are. */
#ifndef WIDE_H
#define WIDE_H

#include <stddef.h>

/* Whether the compiler has vectors. */
#ifdef __GNUC__
#define HAS_LANES 1
#else
#define HAS_LANES 0
#endif

/* Whether steps are compiled for more than every processor can, and chosen when they are called. */
#if HAS_LANES && defined(__x86_64__) && defined(__linux__)
#define CHOOSES_LANES 1
#else
#define CHOOSES_LANES 0
#endif

/* Steps from t[0], ... t[m - 1] of four, of eight instances, whose values are at x[k]. Returns how many were made; the
 * others have to be made one by one. */
size_t wide_steps_4(double *const x[], const double t[], size_t m, double h);
size_t wide_steps_8(double *const x[], const double t[], size_t m, double h);

#endif
