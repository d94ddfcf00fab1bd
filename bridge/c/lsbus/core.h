/* core.h - a node of a deployment as the core of an FMU with a CAN terminal for each of its buses (lsbus.h).
 *
 * The node is that of portable.h; here is its attachment to the terminals, in place of bus.c.
 */
#ifndef CORE_H
#define CORE_H

#include "lsbus.h"
#include "portable.h"

enum { WAITING = 256 }; /* frames between two slots, a power of two */

enum { N_PORTS = N_BUSES };

struct fmu {
    LSBUS_MEMBERS(N_BUSES);
    portable_t node;
    ring_t received[N_BUSES], sent[N_BUSES];
    frame_t received_frames[N_BUSES][WAITING], sent_frames[N_BUSES][WAITING];
};

/* An operation that has arrived from a bus at `at_ns`. */
fmi3Status operation_take(fmu_t *x, int32_t bus, const uint8_t *raw, size_t n, int64_t at_ns);
/* Put the bit rates of a bus, or a frame, into its `tx`. */
fmi3Status operation_rates(fmu_t *x, int32_t bus);
fmi3Status operation_send(fmu_t *x, int32_t bus, const frame_t *frame);

#endif
