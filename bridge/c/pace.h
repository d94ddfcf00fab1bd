/* pace.h: absolute deadlines, and how late one woke. */
#ifndef BRIDGE_PACE_H
#define BRIDGE_PACE_H

#include <stdint.h>

#include "frame.h"

enum { PACE_BINS = 2048 };  /* bins of 1 us to 1024 us, then doubling with 64 a factor of two */

typedef struct {
    int64_t count, minimum, maximum;    /* ns */
    double sum;
    int64_t bins[PACE_BINS];
} histogram_t;

API void histogram_add(histogram_t *h, int64_t ns);
API double histogram_quantile(const histogram_t *h, double q);  /* ns, upper edge of the bin */

API int64_t pace_now(void);                 /* CLOCK_MONOTONIC, ns */
/* Sleeps until the deadline (CLOCK_MONOTONIC, absolute), the last spin_ns of it awake. Returns the
 * time it woke at. Signals do not end the sleep, but *stop != 0 after one does. */
API int64_t pace_wait(int64_t deadline_ns, int64_t spin_ns, const volatile int32_t *stop);

#endif
