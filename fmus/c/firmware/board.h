/* board.h - the functions that the check needs of a board; replace them for a board of your own. */
#ifndef BOARD_H
#define BOARD_H

#include <stdint.h>

/* Write text to the console of the emulator or debugger. */
void board_write(const char *text);

/* End with an exit code. */
void board_end(int code);

/* A counter, modulo 2^32, which is BOARD_TICKS / BOARD_INSTRUCTIONS ahead after each instruction. */
uint32_t board_count(void);
#ifdef __arm__
enum { BOARD_TICKS = 128, BOARD_INSTRUCTIONS = 5 }; /* 25 MHz, and 1024 ns for an instruction */
#else
enum { BOARD_TICKS = 1, BOARD_INSTRUCTIONS = 1 };
#endif

/* Fill the unused stack with a pattern; bytes of it that were used since, and before the call. */
void board_paint(void);
uint32_t board_stack(void);

#endif
