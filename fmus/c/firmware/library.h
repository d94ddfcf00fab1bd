/* library.h - the functions that the code needs of a C library: from the system, or else from here. */
#ifndef LIBRARY_H
#define LIBRARY_H

#if __STDC_HOSTED__
#include <math.h>
#include <string.h>
#else
#define INFINITY __builtin_inf()
#define NAN __builtin_nan("")
#define fabs __builtin_fabs
#define memcpy __builtin_memcpy
#define memset __builtin_memset
#define sqrt any_square_root

/* The square root of any number, rounded to nearest; square_root takes normal ones. */
static inline double any_square_root(double x)
{
    if (!(x > 0.0 && x < INFINITY)) return x >= 0.0 ? x : NAN;
    return x < 0x1p-1022 ? square_root(x * 0x1p108) * 0x1p-54 : square_root(x);
}
#endif

#endif
