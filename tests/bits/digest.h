/* digest.h - a sum of the bits of numbers that does not depend on the byte order. */
#include <stdint.h>
#include <string.h>

static uint64_t digest = 0xcbf29ce484222325u; /* FNV-1a, a number at a time */

static void take(const double *values, size_t n)
{
    for (size_t i = 0; i < n; i++) {
        uint64_t bits;
        memcpy(&bits, values + i, sizeof bits);
        digest = (digest ^ bits) * 0x100000001b3u;
        digest ^= digest >> 29;
    }
}

/* The next of a sequence of numbers from -1 to 1. */
static double number(void)
{
    static uint64_t state = 1;
    state = state * 6364136223846793005u + 1442695040888963407u;
    return (double)(int64_t)(state >> 11) * 0x1p-52 - 1.0;
}
