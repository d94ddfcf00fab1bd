/* virt.c - QEMU's board virt (RISC-V, 32 bits): a 16550 as serial line, and the timer of the hart, 10 MHz.
 *
 * Nothing is done in interrupts: they only end the sleep of the processor (WFI).
 */
#include "board.h"

typedef volatile uint32_t word_t;
typedef volatile uint8_t byte_t;

#define UART ((byte_t *)0x10000000)
#define TIMER ((word_t *)0x0200BFF8)    /* low, high */
#define ALARM ((word_t *)0x02004000)    /* low, high */
#define PRIORITY ((word_t *)0x0C000000) /* of each source of the interrupt controller */
#define ENABLED (*(word_t *)0x0C002000)
#define CLAIM (*(word_t *)0x0C200004) /* read: the source; written: it is done */

enum { DATA, INTERRUPTS, FIFO, LINE_CONTROL, LINE = 5 };
enum { CAME = 1, EMPTY = 32, BITS_8 = 3, DIVIDER = 128, WAITS_FOR_14 = 0xC1 };
enum { UART_SOURCE = 10, TIMER_BIT = 1 << 7, OUTSIDE_BIT = 1 << 11, TICK_NS = 100 };
static const uint32_t PAINT = 0xC0FFEE11;

extern uint32_t bss_begin[], bss_end[], stack_begin[], stack_end[];
int main(void);
void begin(void);

__asm__(".section .vectors, \"ax\"\n"
        ".global _start\n"
        "_start: la sp, stack_end\n"
        "j begin\n"
        ".text\n");

static void setup(void)
{
    UART[LINE_CONTROL] = DIVIDER | BITS_8, UART[DATA] = 1, UART[INTERRUPTS] = 0; /* 115200 bit/s */
    UART[LINE_CONTROL] = BITS_8, UART[FIFO] = WAITS_FOR_14, UART[INTERRUPTS] = 1;
    PRIORITY[UART_SOURCE] = 1, ENABLED = 1 << UART_SOURCE;
    __asm__ volatile(".option push\n.option arch, +zicsr\ncsrw mie, %0\n.option pop"
                     :
                     : "r"(TIMER_BIT | OUTSIDE_BIT));
}

void begin(void)
{
    for (uint32_t *to = bss_begin; to < bss_end;) *to++ = 0;
    for (volatile uint32_t *to = stack_begin; to < (uint32_t *)__builtin_frame_address(0) - 16;)
        *to++ = PAINT;
    setup();
    main();
    board_end();
}

int32_t board_read(uint8_t *to, int32_t n)
{
    int32_t i = 0;
    for (; i < n && UART[LINE] & CAME; i++) to[i] = UART[DATA];
    const uint32_t source = CLAIM;
    if (source) CLAIM = source;
    return i;
}

void board_write(const uint8_t *from, int32_t n)
{
    for (int32_t i = 0; i < n; i++) {
        while (!(UART[LINE] & EMPTY)) {}
        UART[DATA] = from[i];
    }
}

static uint64_t ticks(void)
{
    uint32_t high, low;
    do {
        high = TIMER[1], low = TIMER[0];
    } while (high != TIMER[1]);
    return (uint64_t)high << 32 | low;
}

int64_t board_time_ns(void) { return (int64_t)ticks() * TICK_NS; }

void board_sleep(int64_t until_ns)
{
    const uint64_t until = (uint64_t)until_ns / TICK_NS;
    if (until < ticks() + 20 || UART[LINE] & CAME) return;
    ALARM[1] = UINT32_MAX, ALARM[0] = (uint32_t)until, ALARM[1] = (uint32_t)(until >> 32);
    __asm__ volatile("wfi");
}

uint32_t board_stack(void)
{
    const uint32_t *at = stack_begin;
    while (at < stack_end && *at == PAINT) at++;
    return (uint32_t)((const char *)stack_end - (const char *)at);
}

void board_end(void)
{
    *(word_t *)0x00100000 = 0x5555; /* QEMU ends */
    for (;;) __asm__ volatile("wfi");
}
