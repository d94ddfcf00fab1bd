/* board.h - a board of the examples: a serial line, a clock, and sleep. */
#ifndef BOARD_H
#define BOARD_H

#include <stdint.h>

/* Reads up to n bytes that have come over the serial line, without waiting. Returns their number. */
int32_t board_read(uint8_t *to, int32_t n);
/* Writes bytes to the serial line; may wait until there is room. */
void board_write(const uint8_t *from, int32_t n);
/* Monotonic, ns. */
int64_t board_time_ns(void);
/* Sleeps until `until_ns` or, if a byte comes, less. */
void board_sleep(int64_t until_ns);
/* The greatest use of the stack so far, bytes; 0: unknown. */
uint32_t board_stack(void);
/* The end of the program. */
void board_end(void);

#endif
