/* lanes.h - LANES numbers that are computed with at once, each with the same bits as alone.
 *
 * A template is a header that is included once for doubles and once for lanes, with
 *
 *     REAL              the type of its numbers
 *     TEMPLATE(x)       the name of its function x
 *     TEMPLATE_INLINE   how its functions begin: static inline, or LANES_INLINE
 *
 * Only +, -, * and / are used, which round each lane like a double. Where the compiler has no vectors,
 * HAS_LANES is 0.
 */
#ifndef LANES_H
#define LANES_H

#include <stdint.h>

#if defined(__GNUC__)
#define HAS_LANES 1

/* How vectors are passed depends on the processor; here none is, since all functions are inline. */
#if !defined(__clang__)
#pragma GCC diagnostic ignored "-Wpsabi"
#endif

typedef double Lanes __attribute__((vector_size(32)));
typedef int64_t Mask __attribute__((vector_size(32))); /* of a lane: all bits or none */
typedef char lanes_are_complete[sizeof(Lanes) == LANES * sizeof(double) ? 1 : -1];

/* What a function for a processor calls must be part of it. */
#define LANES_INLINE static inline __attribute__((always_inline))

/* Of each lane a, where the mask is set, or b. */
LANES_INLINE Lanes pick(Mask mask, Lanes a, Lanes b) {
    return (Lanes)((mask & (Mask)a) | (~mask & (Mask)b));
}

/* Compile a function twice, and let it run as the processor can. */
#if defined(__x86_64__) && defined(__linux__)
#define HAS_AVX2 1
#define WITH_AVX2 __attribute__((target("avx2")))
#define CAN_AVX2 __builtin_cpu_supports("avx2")
#else
#define HAS_AVX2 0
#endif

#else
#define HAS_LANES 0
#endif

#endif
