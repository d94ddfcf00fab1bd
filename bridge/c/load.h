/* load.h: how long a CAN frame takes on its bus, to the bit: cosim/c/bus/length.h, for frame_t.
 *
 * The flags FRAME_FD to FRAME_EXTENDED are CAN_FD to CAN_EXTENDED there.
 */
#ifndef BRIDGE_LOAD_H
#define BRIDGE_LOAD_H

#include <stddef.h>
#include <stdint.h>

#include "bus/length.h"
#include "frame.h"

/* {0, 0}: no CAN frame (more than 8, FD 64 bytes; remote FD; error frame). */
API void frame_bits_exact(const frame_t *frame, bits_t *bits);
/* ns, to the nearest; rates in bit/s; data_bitrate 0: as the nominal. 0: no CAN frame. */
API int64_t frame_time_ns(const frame_t *frame, double bitrate, double data_bitrate);

#endif
