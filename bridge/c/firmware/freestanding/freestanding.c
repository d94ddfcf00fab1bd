/* freestanding.c - the functions that the compiler and the headers beside this file expect of a C library. */
#include <stdint.h>

#include "math.h"
#include "string.h"

#if defined(__GNUC__) && !defined(__clang__) /* a loop that copies is no call of memcpy */
#pragma GCC optimize("no-tree-loop-distribute-patterns")
#endif

void *memcpy(void *restrict to, const void *restrict from, size_t n)
{
    unsigned char *a = to;
    const unsigned char *b = from;
    while (n--) *a++ = *b++;
    return to;
}

void *memmove(void *to, const void *from, size_t n)
{
    unsigned char *a = to;
    const unsigned char *b = from;
    for (size_t i = 0; a < b && i < n; i++) a[i] = b[i];
    while (a > b && n--) a[n] = b[n];
    return to;
}

void *memset(void *to, int value, size_t n)
{
    unsigned char *a = to;
    while (n--) *a++ = (unsigned char)value;
    return to;
}

int memcmp(const void *a, const void *b, size_t n)
{
    const unsigned char *x = a, *y = b;
    for (; n--; x++, y++)
        if (*x != *y) return *x - *y;
    return 0;
}

size_t strlen(const char *text)
{
    size_t n = 0;
    while (text[n]) n++;
    return n;
}

/* Rounded to nearest, as IEEE 754 demands: one bit of the root after the other, and one to round by. */
double sqrt(double x)
{
    uint64_t bits, root = 0, sum = 0;
    memcpy(&bits, &x, sizeof bits);
    if (bits << 1 == 0 || bits == UINT64_C(0x7FF) << 52 || x != x) return x; /* 0, infinity, NaN */
    if (bits >> 63) return NAN;
    int32_t exponent = (int32_t)(bits >> 52);
    uint64_t left = bits & ((UINT64_C(1) << 52) - 1);
    if (exponent) left |= UINT64_C(1) << 52;
    else
        for (exponent = 1; !(left >> 52); exponent--) left <<= 1;
    exponent -= 1023;
    if (exponent & 1) left <<= 1, exponent--;
    left <<= 1;
    for (uint64_t bit = UINT64_C(1) << 53; bit; bit >>= 1) {
        const uint64_t trial = sum + bit;
        if (trial <= left) sum = trial + bit, left -= trial, root += bit;
        left <<= 1;
    }
    if (left) root += root & 1;
    bits = (root >> 1) + ((uint64_t)(exponent / 2 + 1022) << 52);
    memcpy(&x, &bits, sizeof x);
    return x;
}
