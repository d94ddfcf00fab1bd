/* real.h - Real, the type of a model's numbers.
 *
 * A step is written over Real, and compiled for one instance and for several at once: TOGETHER of them
 * (lanes.h). For one, Real is double. For several, it is a vector that has a lane for each, and so has Model.
 * +, -, * and / round each lane like a double, and square roots are taken lane by lane; nothing else is used, so
 * that a step has the same bits in a lane.
 * What is different from doubles:
 *
 *     REAL(x)            a double where a Real is expected, as on the right of =; arrays begin as {0}
 *     Truth              of a comparison; combined by & and |, or ALWAYS, NEVER
 *     PICK(truth, a, b)  a where it is true, b elsewhere; of several, both are calculated
 *     ALL(truth)         whether it is true of all instances, an int; ANY(truth): of one or more
 *     COMMON(x)          the double that x is in all of them: of integer parameters, for `if`, counts, indices
 *
 * Instances are stepped together only if their integer parameters are equal. If the step returns a message,
 * nothing has changed, and each is stepped alone. What is not part of a step (model_initial) stands
 * between #if TOGETHER == 1 and #endif.
 */
#ifndef REAL_H
#define REAL_H

#ifndef TOGETHER
#define TOGETHER 1
#endif

/* Clang contracts a*b + c to one rounding where the processor can; every build must round twice. */
#ifdef __clang__
#pragma STDC FP_CONTRACT OFF
#endif

/* Before a loop over the entries of a vector or a matrix: with -O2, GCC unrolls it only if asked. */
#ifdef __GNUC__
#define UNROLLED _Pragma("GCC unroll 9")
#else
#define UNROLLED
#endif

/* Before a part of a step that is compiled into it: where it is called, vectors are handed over in memory. */
#ifdef __GNUC__
#define INLINED inline __attribute__((always_inline))
#else
#define INLINED inline
#endif

#if TOGETHER == 1

typedef double Real;
typedef int Truth;
#define NEVER 0
#define ALWAYS 1
#define REAL(x) (x)
#define PICK(truth, a, b) ((truth) ? (a) : (b))
#define ALL(truth) (truth)
#define ANY(truth) (truth)
#define COMMON(x) (x)

#else
#include <stdint.h>

/* How vectors are passed depends on the processor; here no other compilation calls with them. */
#if !defined(__clang__)
#pragma GCC diagnostic ignored "-Wpsabi"
#endif

typedef double Real __attribute__((vector_size(8 * TOGETHER)));
typedef int64_t Truth __attribute__((vector_size(8 * TOGETHER))); /* of a lane: all bits or none */

static inline Real pick(Truth truth, Real a, Real b)
{
    return (Real)((truth & (Truth)a) | (~truth & (Truth)b));
}

static inline int all_lanes(Truth truth)
{
#ifdef SIGNS /* the signs of all lanes as bits, by one instruction */
    return SIGNS(truth) == (1 << TOGETHER) - 1;
#else
    int64_t all = truth[0];
    for (int k = 1; k < TOGETHER; k++) all &= truth[k];
    return all != 0;
#endif
}

/* x - 0 is x, also of -0; it makes a vector of a double. */
#define NEVER ((Truth){0})
#define ALWAYS (~NEVER)
#define REAL(x) ((x) - (Real){0.0})
#define PICK(truth, a, b) pick((truth), REAL(a), REAL(b))
#define ALL(truth) all_lanes(truth)
#define ANY(truth) (!all_lanes(~(truth)))
#define COMMON(x) ((x)[0])

#endif
#endif
