/* faults.h: faults on purpose, in frames as they come in, before anything is checked.
 *
 * A rule holds from t0 to t1 (ns since the start) for frames whose id, masked, fits. Seeded:
 * every rule has its own generator (SplitMix64), asked once a frame that fits.
 */
#ifndef BRIDGE_FAULTS_H
#define BRIDGE_FAULTS_H

#include "frame.h"

enum { FAULT_DROP, FAULT_BURST /* drop `count` in a row */, FAULT_DELAY /* by `a` to `b` s, in order */,
       FAULT_JITTER /* by `a` to `b` s, may overtake */, FAULT_DUPLICATE, FAULT_REORDER /* with the next */,
       FAULT_CORRUPT /* flip `count` bits of the data */ };

typedef struct {
    int32_t kind, count;
    int64_t t0_ns, t1_ns;
    uint32_t id, mask;
    double probability, a, b;
    uint64_t random;        /* state of the generator */
    int64_t left;           /* of a burst */
    int64_t hits;           /* frames it did something to */
} fault_t;

typedef struct {
    fault_t *rules;
    int64_t n_rules;
    frame_t *waiting;       /* capacity; held back, sorted by t_ns (when they get through) */
    int64_t n_waiting, capacity;
    int64_t injected;       /* frames changed in any way */
    int64_t corrupted;
} faults_t;

/* Takes a frame in; what comes out (none, one, more) waits inside. t_ns is the arrival. */
API void faults_put(faults_t *f, const frame_t *frame, int64_t start_ns);
/* The next that gets through by now: 1 and *frame with its new t_ns, or 0. */
API int32_t faults_get(faults_t *f, frame_t *frame, int64_t now_ns);

#endif
