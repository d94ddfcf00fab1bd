/* delay.h: the configured latency of a link, at its receiver, in addition to the delay of the network.
 *
 * Laws, seeds and semantics are those of cosim.links: Python draws the delays T before the run
 * (`delays`, s; not finite: lost). A sample has its number j, its arrival a_j and the nominal time s_j
 * of its transmission; the delay of the network is d_j = a_j - s_j (0 if negative). The link behaves
 * as its table would with the delays T + d:
 *
 *   DELAY_NONE     the newest sample that was put, whatever `now`
 *   DELAY_SIGNAL   delays[row], T at reception: the sample nearest to now - T - d, d of the newest
 *                  that has arrived; if it is missing, the next older one. Can go back to -1.
 *   DELAY_LAST     delays[j], T at sending: arrives at a_j + T_j; the newest arrival wins, and of
 *                  two in one base tick the later sent
 *   DELAY_STAMP    as LAST, but a sample that is not newer than the held one is ignored
 *   DELAY_FIFO     as LAST, but no sample arrives before an earlier sent one. Samples that the
 *                  network lost are not waited for; overtaken samples are ignored.
 *   DELAY_PLAYOUT  plays the newest sent at or before now - buffer if its a_j + T_j has passed, else
 *                  holds
 *   DELAY_QUEUE    as LAST, but samples that get through wait in a queue of `depth`, behind the network
 *                  and the law; a look takes the first of them, or all of them and holds the last. A
 *                  look that a node leaves out takes nothing.
 *
 * Time is counted in base ticks as the tables do, so that it is exact for any h: sample j is sent at
 * tick period*j, row r looks at tick look*r, and only d is in ns. With d = 0 the rows are those of
 * cosim.links exactly, which a test checks. Except for DELAY_NONE, the nominal time of a read counts,
 * not the actual one: a late node holds the sample that it would have held on time.
 */
#ifndef BRIDGE_DELAY_H
#define BRIDGE_DELAY_H

#include <stddef.h>
#include <stdint.h>

#include "frame.h"

enum { DELAY_NONE, DELAY_SIGNAL, DELAY_LAST, DELAY_STAMP, DELAY_FIFO, DELAY_PLAYOUT, DELAY_QUEUE };

typedef struct {
    int64_t sequence;            /* -1: empty */
    int64_t sent_ns, arrival_ns; /* as they were given */
    int64_t due;                 /* base tick in which it gets through; SIGNAL: in which it arrived */
} sample_t;

typedef struct {
    int64_t due, sequence;
} waiting_t;

typedef struct {
    int32_t kind, width;
    int32_t period, look; /* of the sender, of the receiver, base ticks */
    double h;             /* s, base tick */
    double buffer;        /* s, PLAYOUT */
    int64_t phase_ns;     /* of the receiver's slots, less that of the sender's */
    const double *delays; /* s: by row (SIGNAL), by sequence (others); NULL: none */
    int64_t n_delays;     /* after the last they begin again: a constant needs one */
    int64_t capacity;     /* samples kept, a power of two */
    sample_t *samples;    /* (capacity,), slot sequence % capacity */
    double *values;       /* (capacity + 1, width); the last row is what is held */
    waiting_t *queue;     /* (capacity,), a heap: the earliest due on top */
    int64_t n_queue;
    int64_t *line; /* (depth,), QUEUE: the sequences that wait, the first at line_first */
    int64_t depth, line_first, n_line;
    int32_t drops_newest, takes_all; /* QUEUE: what a full one drops, what a look takes */
    int64_t looked;                  /* QUEUE: the last row, -1: none */
    int64_t newest;                  /* sequence put, -1: none */
    int64_t visible;                 /* SIGNAL: the newest that has arrived, -1: none */
    int64_t network_ns;              /* SIGNAL: what the network took for that one */
    int64_t last_due;                /* FIFO: of the newest */
    int64_t held;                    /* sequence given last, -1: none */
    sample_t given;                  /* what is held; its age is now - given.sent_ns */
    int64_t lost;                    /* by law */
    int64_t ignored;                 /* put twice, too old to keep, or (FIFO) overtaken */
    int64_t forgotten;               /* gone before it was due or wanted: capacity too small */
    int64_t dropped;                 /* by a full queue */
    int64_t reserved[2];
} delay_t;

/* Empty, nothing held, nothing counted. Before the first sample. */
API void delay_reset(delay_t *d);
/* A sample that has arrived. Times relative to the start of the run, ns. */
API void delay_put(delay_t *d, int64_t sequence, int64_t sent_ns, int64_t arrival_ns, const double *values);
/* The sequence number held at look `row`, -1: none yet (the initial value holds). Rows ascend.
 * Its values are delay_values(d, sequence). now_ns, the look's nominal time, is not looked at. */
API int64_t delay_take(delay_t *d, int64_t row, int64_t now_ns);

/* The lead of the line, ns: samples sent less than this before a slot of the receiver do not change what
 * it holds in the slot, if the network takes no time. 0 at least; by the least of the drawn delays. */
API int64_t delay_lead_ns(const delay_t *d);

/* What is held stays there when its slot is used again; any other only while it is kept. */
static inline const double *delay_values(const delay_t *d, int64_t sequence)
{
    const int64_t row = sequence == d->held ? d->capacity : sequence & (d->capacity - 1);
    return d->values + row * d->width;
}

#endif
