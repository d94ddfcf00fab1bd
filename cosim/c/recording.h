/* recording.h: rows of signals into the columns of a recording. */
#ifndef COSIM_RECORDING_H
#define COSIM_RECORDING_H

#include <stdint.h>

#include "engine.h"

/* A row group that is being filled: `columns` (1 + n_columns, room), first the times, s, then the signals of `index`. */
typedef struct {
    double *columns;
    int64_t room, n_columns;
    const int64_t *index;
    int64_t every;   /* ticks between two rows */
    double h, start; /* s: base step, and the time of tick 0 */
} recording_t;

/* Put `n` rows, `stride` numbers apart, into the columns from entry `fill` on; the first one is of `tick`. */
API void recording_take(const recording_t *x, const double *rows, int64_t stride, int64_t n, int64_t tick,
                        int64_t fill);

#endif
