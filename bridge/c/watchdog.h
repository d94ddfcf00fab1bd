/* watchdog.h: time limits between events, and presence of peers.
 *
 * Deterministic: its inputs are recorded, so a replay takes the same decisions. docs/safety.md describes
 * every rule and how to reset it. */
#ifndef BRIDGE_WATCHDOG_H
#define BRIDGE_WATCHDOG_H

#include <stdint.h>

#include "frame.h"

typedef struct {
    int64_t timeout_ns; /* 0: off */
    int64_t last_ns;    /* fed; before the first time: armed at */
    int32_t latched, reserved;
    int64_t trips;
} watchdog_t;

API void watchdog_feed(watchdog_t *w, int64_t now_ns);     /* does not unlatch */
API int32_t watchdog_check(watchdog_t *w, int64_t now_ns); /* 1: expired (stays so until reset) */
API void watchdog_reset(watchdog_t *w, int64_t now_ns);    /* unlatched, and fed now */

/* Another node, from its heartbeats. */
typedef struct {
    watchdog_t heartbeat;
    int32_t state;           /* LIFE_ of the last heartbeat, -1: none yet */
    int32_t required;        /* its loss stops this node */
    uint32_t boots;          /* changes when it restarts */
    uint32_t number;         /* node number */
    int64_t heard;           /* heartbeats */
    int32_t takes, reserved; /* it takes torques of this node: in FAULT its drives are off */
} peer_t;

/* A heartbeat has arrived. The life cycle latches, not the peer: a peer that is received again is present.
 * Returns WHY_PEER when a required peer has restarted, else 0. */
API uint32_t peer_heartbeat(peer_t *peer, int32_t state, uint32_t boots, int64_t now_ns);
/* WHY_PEER while a required peer is silent, STOPPING or in FAULT; one that has FINISHED may be silent. And
 * WHY_DRIVE while one that takes torques is in FAULT. */
API uint32_t peer_check(peer_t *peer, int64_t now_ns);

#endif
