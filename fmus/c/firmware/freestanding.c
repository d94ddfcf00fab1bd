/* freestanding.c - functions that compilers call even without a C library, and the mark of the stack. */
#include <stddef.h>

#include "board.h"

extern uint32_t stack_low[];

enum { PATTERN = 0x5AC3 };

void *memcpy(void *to, const void *from, size_t size);
void *memset(void *to, int value, size_t size);

/* The pointers are volatile, so that no compiler makes a call of memcpy of the loop. */
void *memcpy(void *to, const void *from, size_t size)
{
    volatile unsigned char *a = to;
    const unsigned char *b = from;
    while (size--) *a++ = *b++;
    return to;
}

void *memset(void *to, int value, size_t size)
{
    volatile unsigned char *a = to;
    while (size--) *a++ = (unsigned char)value;
    return to;
}

static uint32_t *top;

/* The words next to `top` belong to this call. */
void board_paint(void)
{
    top = (uint32_t *)__builtin_frame_address(0);
    for (volatile uint32_t *word = stack_low; word < top - 16; word++) *word = PATTERN;
}

uint32_t board_stack(void)
{
    const uint32_t *word = stack_low;
    while (word < top && *word == PATTERN) word++;
    return (uint32_t)((uintptr_t)top - (uintptr_t)word);
}
