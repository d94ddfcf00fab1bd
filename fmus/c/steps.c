/* steps.c - steps of several instances, as many at once as the processor can. */
#include <stddef.h>

#include "declaration.h"
#include "wide.h"

#if CHOOSES_LANES
static int has_avx512(void)
{
    return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq");
}

size_t model_lanes(void) { return has_avx512() ? 8 : __builtin_cpu_supports("avx2") ? 4 : 1; }

static size_t wide_steps(size_t width, double *const x[], const double t[], size_t m, double h)
{
    return width == 8 ? wide_steps_8(x, t, m, h) : wide_steps_4(x, t, m, h);
}
#elif HAS_LANES
size_t model_lanes(void) { return 4; }

static size_t wide_steps(size_t width, double *const x[], const double t[], size_t m, double h)
{
    return (void)width, wide_steps_4(x, t, m, h);
}
#else
size_t model_lanes(void) { return 1; }

static size_t wide_steps(size_t width, double *const x[], const double t[], size_t m, double h)
{
    return (void)width, (void)x, (void)t, (void)m, (void)h, 0;
}
#endif

/* Step n <= WIDEST instances at once; lanes that are left over do what the first one does. Returns how many steps were
 * made. */
static size_t at_once(Model *const x[], size_t n, const double t[], size_t m, double h)
{
    double *values[WIDEST];
    const size_t width = n <= 4 ? 4 : WIDEST;
    for (size_t k = 0; k < width; k++) values[k] = (double *)x[k < n ? k : 0];
    return wide_steps(width, values, t, m, h);
}

void model_steps(Model *const x[], size_t n, const double t[], size_t m, double h, size_t made[],
                 const char *why[])
{
    const size_t lanes = model_lanes();
    for (size_t i = 0, some; i < n; i += some) {
        some = n - i < lanes ? n - i : lanes;
        const size_t done = some > 1 ? at_once(x + i, some, t, m, h) : 0;
        for (size_t k = i; k < i + some; k++) {
            why[k] = NULL;
            made[k] = done;
            while (made[k] < m && (why[k] = model_step(x[k], t[made[k]], h)) == NULL) made[k]++;
        }
    }
}
