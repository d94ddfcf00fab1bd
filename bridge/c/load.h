/* load.h: how long a CAN frame takes on its bus, to the bit.
 *
 * Bit times as in cosim/bus/timing.py: classic and FD (ISO 11898-1:2015), from start of frame to
 * the end of the intermission, stuff bits from the frame's own bits. FD frames of a length there is
 * none of count as filled with zeros to the next.
 */
#ifndef BRIDGE_LOAD_H
#define BRIDGE_LOAD_H

#include <stddef.h>
#include <stdint.h>

#include "frame.h"

typedef struct {
    int32_t nominal, data;          /* bit times at each bit rate; data: FD with BRS only */
} bits_t;

/* {0, 0}: no CAN frame (more than 8, FD 64 bytes; remote FD; error frame). */
API void frame_bits_exact(const frame_t *frame, bits_t *bits);
/* ns, to the nearest; rates in bit/s; data_bitrate 0: as the nominal. 0: no CAN frame. */
API int64_t frame_time_ns(const frame_t *frame, double bitrate, double data_bitrate);

#endif
