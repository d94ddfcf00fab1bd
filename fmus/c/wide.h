/* wide.h - steps of several instances at once, and which of them there are. */
#ifndef WIDE_H
#define WIDE_H

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

/* One step of four, of eight instances, whose values are at x[k]. Returns 1; or 0, and nothing has changed:
 * they have to be stepped one by one. */
int wide_step_4(double *const x[], double t, double h);
int wide_step_8(double *const x[], double t, double h);

#endif
