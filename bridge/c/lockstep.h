/* lockstep.h: a node that advances as fast as its samples arrive.
 *
 * The node runs on the simulated clock, over its own memory buses. It receives its samples slot by
 * slot, with the times of the twin, from streams that contain every sample of the run. A slot is
 * executed once all samples have arrived that were sent before it: at an earlier time, or at the same
 * time by a node that precedes this one. The result therefore equals the twin's to the last bit, on
 * any network without losses. Buses must carry messages in order (reliable, blocking).
 *
 * Look-ahead: a stream with a lead feeds only delay lines that give no sample earlier than this after it
 * was sent, so the node receives each sample that much later, in the same slot for any network, and runs up
 * to the lead ahead of it. What the twin knows of such a sample by then is that it was sent and accepted:
 * `promised` of its reception. If it is refused after all (range, rate), the run ends with LOCKSTEP_REFUSED.
 *
 * What a node sends waits in the queue of its bus until the node has to wait itself, or for FLUSH_NS; so all
 * samples of a window are handed over at once.
 *
 * Checkpoints: before the first slot at or after `until_ns` the node waits for all samples that were sent
 * before this time, and returns LOCKSTEP_UNTIL; the next call continues. If all nodes stand at the same time
 * there, no sample is on its way that was sent before.
 */
#ifndef BRIDGE_LOCKSTEP_H
#define BRIDGE_LOCKSTEP_H

#include "node.h"

/* What lockstep_run returns besides LIVE_FINISHED, LIVE_STOPPED and the engine's results. */
enum { LOCKSTEP_STALLED = -10, LOCKSTEP_LOST = -11, LOCKSTEP_REFUSED = -12, LOCKSTEP_UNTIL = -13 };

typedef struct {
    const message_t *message; /* whose frames it holds */
    int32_t bus;
    int32_t before;               /* at equal times its sender comes first */
    int64_t period_ns, offset_ns; /* sample s is sent at s*period + offset */
    int64_t lead_ns;         /* least lead of the delay lines it feeds, see delay_lead_ns; 0: no look-ahead */
    reception_t *reception;  /* of the node */
    int64_t received, given; /* samples 0.. that are there; that the node has heard */
    int64_t capacity;        /* samples of the run */
    frame_t *frames;
} stream_t;

typedef struct {
    node_t *node;   /* clock: CLOCK_SIMULATED; its buses: BUS_MEMORY */
    bus_t *outside; /* one a bus of the node: BUS_RING */
    stream_t *streams;
    int32_t n_streams;
    int32_t awaited;     /* the stream that a slot waits for, -1: none */
    int64_t patience_ns; /* without anything new: stalled */
    int64_t found;       /* LOST: number of the sample that came instead, modulo 65536 */
    int64_t unsent_ns;   /* since when something waits to be handed over (CLOCK_MONOTONIC); 0: nothing */
    int64_t until_ns;    /* relative to the start; < 0: to the end */
    int32_t resumed;     /* 1: it continues a run from the middle, with the state that it had there */
    int32_t begun;       /* START has come */
} lockstep_t;

/* Samples sent before a slot at deadline_ns (relative): 0 .. this - 1. */
API int64_t lockstep_sent(const stream_t *s, int64_t deadline_ns);
/* Those of them that the slot needs. */
API int64_t lockstep_needed(const stream_t *s, int64_t deadline_ns);

/* Those of them that were sent before a time. */
API int64_t lockstep_sent_before(const stream_t *s, int64_t time_ns);

/* All slots to the end, or to until_ns; waits for COMMAND_START first. Reads clocks, to wait and for patience
 * only. */
API int32_t lockstep_run(lockstep_t *l);

#endif
