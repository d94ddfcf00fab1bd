/* mail.h: a ring between a C loop and Python threads, each of which may sleep until a frame arrives.
 *
 * The loop uses bus_send and bus_receive; this file has the other side, and the sleep of the loop.
 */
#ifndef BRIDGE_MAIL_H
#define BRIDGE_MAIL_H

#include "frame.h"

enum { MAIL_FULL, MAIL_BROUGHT, MAIL_ASLEEP };

/* Puts data that has just arrived into the ring. BROUGHT: done; ASLEEP: done, and a thread that sleeps in
 * mail_wait must be woken by mail_wake; FULL: the ring is full, or the data is longer than a frame
 * (counted as dropped). One writer at a time: several threads must hold the GIL. */
API int32_t mail_bring(ring_t *ring, uint32_t id, const void *data, int64_t length);

/* Call it without the GIL, which the woken thread may need immediately. */
API void mail_wake(ring_t *ring);

/* Sleeps until there is something to take, or the deadline (CLOCK_MONOTONIC, ns): 1, or 0: there is
 * nothing. What is not brought by mail_bring is seen at the deadline only, and where there is no
 * futex (not Linux) at one of many looks. */
API int32_t mail_wait(ring_t *ring, int64_t deadline_ns);

/* Takes the next frame; if there is none, first sleeps until `fd` (bus_t) is written to: 1, or 0: woken
 * and nothing there. */
API int32_t mail_next(ring_t *ring, int32_t fd, frame_t *frame);

#endif
