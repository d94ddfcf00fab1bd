/* numbers.c: copies of numbers, and whether they are finite. Of few of them without a call; of many in blocks, the last of
 * which overlaps the one before: a processor mispredicts the end of short loops, and waits for that.
 */
#include "engine_internal.h"

enum { BLOCK = 4, CALLED = 32 }; /* numbers: of a block; more than that memcpy copies faster */

/* An exponent of all ones is not a finite number: one more carries into the sign bit. */
INLINE uint64_t carry_of(double x)
{
    uint64_t bits;
    memcpy(&bits, &x, sizeof bits);
    return (bits & 0x7ff0000000000000u) + 0x0010000000000000u;
}

#if defined(__GNUC__)
typedef uint64_t pair_t __attribute__((vector_size(16)));

INLINE pair_t carries_of(const double *x)
{
    pair_t a, b;
    memcpy(&a, x, sizeof a);
    memcpy(&b, x + 2, sizeof b);
    return ((a & 0x7ff0000000000000u) + 0x0010000000000000u) |
           ((b & 0x7ff0000000000000u) + 0x0010000000000000u);
}
#endif

SHARED int any_not_finite(const double *x, int64_t n)
{
    uint64_t carry = 0;
#if defined(__GNUC__)
    if (n >= BLOCK) {
        pair_t carries = carries_of(x + n - BLOCK);
        for (int64_t i = 0; i < n - BLOCK; i += BLOCK) carries |= carries_of(x + i);
        return (carries[0] | carries[1]) >> 63 != 0;
    }
#endif
    for (int64_t i = 0; i < n; i++) carry |= carry_of(x[i]);
    return carry >> 63 != 0;
}

HOT int not_finite(const double *x, int64_t n)
{
    if (n == 1) return carry_of(*x) >> 63 != 0;
    return any_not_finite(x, n);
}

INLINE void copy_two(double *target, const double *source) { memcpy(target, source, 2 * sizeof *target); }

SHARED void copy_many(double *target, const double *source, int64_t n)
{
    if (n > CALLED) {
        memcpy(target, source, (size_t)n * sizeof *target);
        return;
    }
    if (n >= BLOCK) {
        for (int64_t i = 0; i < n - BLOCK; i += BLOCK) {
            copy_two(target + i, source + i);
            copy_two(target + i + 2, source + i + 2);
        }
        copy_two(target + n - 4, source + n - 4);
    }
    if (n > 1) copy_two(target + n - 2, source + n - 2);
    if (n == 3) *target = *source;
}

HOT void copy(double *target, const double *source, int64_t n)
{
    if (n == 1) *target = *source;
    else if (n == 2) copy_two(target, source);
    else copy_many(target, source, n);
}
