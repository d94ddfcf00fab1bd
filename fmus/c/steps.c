/* steps.c - the step of several instances, as many at once as the processor can. */
#include <stddef.h>

#include "declaration.h"
#include "wide.h"

#if CHOOSES_LANES
static int has_avx512(void) {
    return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq");
}

size_t model_lanes(void) {
    return has_avx512() ? 8 : __builtin_cpu_supports("avx2") ? 4 : 1;
}

static int wide_step(size_t width, double *const x[], double t, double h) {
    return width == 8 ? wide_step_8(x, t, h) : wide_step_4(x, t, h);
}
#elif HAS_LANES
size_t model_lanes(void) { return 4; }

static int wide_step(size_t width, double *const x[], double t, double h) {
    return (void)width, wide_step_4(x, t, h);
}
#else
size_t model_lanes(void) { return 1; }

static int wide_step(size_t width, double *const x[], double t, double h) {
    return (void)width, (void)x, (void)t, (void)h, 0;
}
#endif

/* Step n <= WIDEST instances at once; lanes that are left over do what the first one does. Returns 1; or 0, and
 * nothing has changed. */
static int at_once(Model *const x[], size_t n, double t, double h) {
    double *values[WIDEST];
    const size_t width = n <= 4 ? 4 : WIDEST;
    for (size_t k = 0; k < width; k++) values[k] = (double *)x[k < n ? k : 0];
    return wide_step(width, values, t, h);
}

void model_steps(Model *const x[], size_t n, double t, double h, const char *why[]) {
    const size_t lanes = model_lanes();
    for (size_t i = 0, some; i < n; i += some) {
        some = n - i < lanes ? n - i : lanes;
        const int done = some > 1 && at_once(x + i, some, t, h);
        for (size_t k = i; k < i + some; k++) why[k] = done ? NULL : model_step(x[k], t, h);
    }
}
