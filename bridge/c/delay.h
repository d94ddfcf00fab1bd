/* delay.h: the configured latency of a link, at its receiving side, on top of what the network takes.
 *
 * The same laws, seeds and semantics as cosim.links: delays are drawn before the run by Python
 * (`delays`, s; not finite: lost). Samples come in with their number j, arrival a_j and the time
 * s_j at which they were nominally sent; what the network took is d_j = a_j - s_j >= 0.
 *
 *   DELAY_NONE     the newest sample that has arrived
 *   DELAY_SIGNAL   delays[row], T at reception: the sample nearest to now - T - d, d of the newest
 *   DELAY_LAST     delays[j], T at sending: arrives at a_j + T_j; the newest arrival wins
 *   DELAY_STAMP    as LAST, but what was sent no later than what is held is ignored
 *   DELAY_FIFO     as LAST, but nothing arrives before what was sent before it
 *   DELAY_PLAYOUT  plays the newest sent at or before now - buffer whose a_j + T_j has passed
 *
 * With d = 0 (arrival = nominal time of sending) and looks at nominal times it gives the rows of
 * cosim.links exactly; that is its test.
 */
#ifndef BRIDGE_DELAY_H
#define BRIDGE_DELAY_H

#include <stdint.h>

#include "frame.h"

enum { DELAY_NONE, DELAY_SIGNAL, DELAY_LAST, DELAY_STAMP, DELAY_FIFO, DELAY_PLAYOUT };

typedef struct {
    int64_t sequence;       /* -1: empty */
    int64_t sent_ns, arrival_ns;    /* relative to the start of the run */
    int64_t due_ns;         /* when it gets through (LAST, STAMP, FIFO, PLAYOUT) */
} sample_t;

typedef struct {
    int32_t kind, width;
    const double *delays;   /* s: by row (SIGNAL), by sequence (others); NULL: none */
    int64_t n_delays;
    int64_t period_ns, h_ns;    /* of the sender, of the base tick */
    int64_t look_ns;        /* of the receiver */
    int64_t buffer_ns;      /* PLAYOUT */
    int64_t capacity;       /* samples kept, a power of two */
    sample_t *samples;      /* slot sequence % capacity */
    double *values;         /* capacity rows of `width` */
    int64_t newest;         /* sequence, -1: none */
    int64_t held;           /* sequence given last, -1: none */
    int64_t lost;           /* by law */
    int64_t reserved[4];    /* carries of the semantics */
} delay_t;

/* A sample that has arrived. Times relative to the start of the run. */
API void delay_put(delay_t *d, int64_t sequence, int64_t sent_ns, int64_t arrival_ns,
                   const double *values);
/* The sequence number held at look `row` (now_ns: its nominal time), -1: none yet. Its values are
 * delay_values(d, sequence). */
API int64_t delay_take(delay_t *d, int64_t row, int64_t now_ns);
static inline const double *delay_values(const delay_t *d, int64_t sequence)
{
    return d->values + (sequence & (d->capacity - 1)) * d->width;
}

#endif
