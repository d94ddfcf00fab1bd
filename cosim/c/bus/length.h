/* length.h: the length of a CAN frame on its bus, exact to the bit.
 *
 * Bit times as in cosim/bus/timing.py: classic and FD frames (ISO 11898-1:2015) from the start of
 * frame to the end of the intermission, with the stuff bits of the frame's own bits. An FD frame of
 * a length that does not exist counts as filled with zeros up to the next length.
 */
#ifndef CAN_LENGTH_H
#define CAN_LENGTH_H

#include <stdint.h>

enum { CAN_FD = 1, CAN_BRS = 2, CAN_ESI = 4, CAN_REMOTE = 8, CAN_EXTENDED = 16 };

typedef struct {
    int32_t nominal, data; /* bit times at each bit rate; data: FD with BRS only */
} bits_t;

/* The length on the bus in bytes; -1: CAN has no such frame. */
int32_t can_padded(uint32_t flags, int32_t length);
/* The DLC of a length on the bus. */
uint32_t can_code(int32_t padded);
/* `length` bytes of data; of a remote frame: the length it asks for. {0, 0}: no such frame. */
bits_t can_bits(uint32_t id, uint32_t flags, int32_t length, const uint8_t *data);

#endif
