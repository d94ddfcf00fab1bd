/* bringup.h: drives with protocols of their own, as their node brings them up, watches, feeds and disables
 * them. `now_ns` is the time of frame stamps: CLOCK_MONOTONIC, or the simulated clock. */
#ifndef BRIDGE_BRINGUP_H
#define BRIDGE_BRINGUP_H

#include "node.h"

/* A frame is none of a drive; tells a state, and may carry values, too; or is an answer and nothing else. */
enum { HEARD_NOT, HEARD_STATE, HEARD_ANSWER };

/* Reads the state of a drive and the answers to a step from a frame. Returns HEARD_. */
API int32_t bringup_hear(node_t *n, const frame_t *frame);
/* Raises WHY_DRIVE for a drive that is ready and tells another state than enabled, or nothing for too long. */
API void bringup_watch(node_t *n, int64_t now_ns);
/* The node stood still for so long, before its first slot, and asked its drives for nothing meanwhile: that
 * is no silence of theirs. */
API void bringup_excuse(node_t *n, int64_t late_ns);
/* Called in each slot and before the first one: begins and continues the bring-up of an armed node, sends
 * torque 0 to drives that nothing else feeds (`feed_all`: also to those that are ready), and disables the
 * drives of a node that is neither armed nor running, in FAULT again every 100 ms.
 * Returns ROW_ENABLED when the last drive becomes ready, ROW_DISABLED when they are disabled, else 0. */
API uint32_t bringup_step(node_t *n, int64_t now_ns, int32_t feed_all);
/* Disables all drives now. */
API void bringup_rest(node_t *n, int64_t now_ns);
/* Whether all drives are ready and their positions are those of now: not older than the node accepts
 * in its run, and not older than a state may be. */
API int32_t bringup_ready(const node_t *n, int64_t now_ns);
/* Keeps what each drive lacks now: `lacks`. */
void bringup_keep_lacks(node_t *n, int64_t now_ns);
/* Bits of the drives that torques are sent to; and the same in a replay. */
uint64_t bringup_serving(const node_t *n);
void bringup_replay(node_t *n, uint64_t serving);
/* Where time begins with the first slot, drives begin as a bring-up leaves them: they told so now. */
void bringup_assume(node_t *n, int64_t now_ns);
/* Feeds ready drives until *stop: while a life that joins a run starts its components. */
API void bringup_feed_until(node_t *n, const int32_t *stop);

#endif
