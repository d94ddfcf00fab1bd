/* pace.h: absolute deadlines and wake-up latency. The only reader of clocks in C. */
#ifndef BRIDGE_PACE_H
#define BRIDGE_PACE_H

#include <stddef.h>
#include <stdint.h>

#include "frame.h"

typedef struct {                     /* empty: all zero */
    int64_t count, minimum, maximum; /* ns */
    double sum;
    int64_t bins[PACE_BINS];
} histogram_t;

/* Bin b < 1024 counts [b, b+1) us; above, bin 1024 + 64 o + s counts from 2^o (1024 + 16 s) us to the
 * next. What is negative counts in the first, what is 2^26 us (67 s) or more in the last. */
API void histogram_add(histogram_t *h, int64_t ns);
/* ns, upper edge of the bin (at most the maximum) of the ceil(q count)-th smallest; NaN: empty. */
API double histogram_quantile(const histogram_t *h, double q);

/* CLOCK_MONOTONIC, ns; macOS: CLOCK_UPTIME_RAW, Windows: performance counter (as cosim.base.clock). */
API int64_t pace_now(void);
/* What to add to pace_now() for the date, CLOCK_REALTIME, ns: it may jump. */
API int64_t pace_date(void);
/* Sleeps until the deadline (CLOCK_MONOTONIC, absolute), polling in the last spin_ns. Returns the
 * wake-up time. Signals do not end the sleep, but *stop != 0 after one does; so does *stop != 0
 * at the start and in the spin. stop may be NULL. A deadline that has passed returns at once. */
API int64_t pace_wait(int64_t deadline_ns, int64_t spin_ns, const volatile int32_t *stop);

/* n deadlines start_ns + k period_ns, and nothing in between: woke[k], ns. Returns how many there
 * were: fewer than n when *stop != 0. For the self-test before a run. */
API int64_t pace_run(int64_t start_ns, int64_t period_ns, int64_t n, int64_t spin_ns,
                     const volatile int32_t *stop, int64_t *woke);

#endif
