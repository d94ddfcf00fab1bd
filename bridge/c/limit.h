/* limit.h: what the values of a message may be. */
#ifndef BRIDGE_LIMIT_H
#define BRIDGE_LIMIT_H

#include <stdint.h>

#include "frame.h"

/* What a received value may be, in the unit of the value. */
typedef struct {
    double low, high; /* +-infinity: not limited */
    double rate;      /* unit/s; infinity: not limited */
    int64_t falls;    /* 1: torque; it may go to 0 at any rate, as guards and ramps take it away */
} limit_t;

/* Whether all values are within their ranges; limits NULL: yes. */
API int32_t limits_range(const limit_t *limits, int32_t n, const double *values);
/* Whether none has changed faster than it may since `last`, so many seconds ago. */
API int32_t limits_rate(const limit_t *limits, int32_t n, const double *values, const double *last,
                        double seconds);

#endif
