/* mps2.c - QEMU's boards mps2-an386 (Cortex-M4) and mps2-an500 (Cortex-M7): UART 0, and two timers of 25 MHz.
 *
 * Nothing is done in interrupts: they only end the sleep of the processor (WFI). */
#include "board.h"

typedef volatile uint32_t word_t;
typedef struct {
    word_t data, state, control, interrupt, divider;
} uart_t;
typedef struct {
    word_t control, value, reload, interrupt;
} timer_t;

#define UART ((uart_t *)0x40004000)
#define CLOCK ((timer_t *)0x40000000) /* counts down for ever */
#define ALARM ((timer_t *)0x40001000) /* ends a sleep */
#define ENABLED (*(word_t *)0xE000E100)
#define PENDING (*(word_t *)0xE000E280) /* written: cleared */
#define COPROCESSORS (*(word_t *)0xE000ED88)

enum { SENDING = 1, CAME = 2 /* state */, BOTH = 3, CAME_INTERRUPT = 8 /* control */ };
enum { UART_BIT = 1 << 0, ALARM_BIT = 1 << 9, TICK_NS = 40, ON = 1, ON_INTERRUPT = 9 };
static const uint32_t PAINT = 0xC0FFEE11;

extern uint32_t data_from[], data_begin[], data_end[], bss_begin[], bss_end[], stack_begin[], stack_end[];
int main(void);
void _start(void);

static void setup(void)
{
    UART->divider = 16, UART->control = BOTH | CAME_INTERRUPT;
    CLOCK->reload = UINT32_MAX, CLOCK->value = UINT32_MAX, CLOCK->control = ON;
    ENABLED = UART_BIT | ALARM_BIT;
    __asm__ volatile("cpsid i");
}

void _start(void)
{
#if defined(__ARM_FP)
    COPROCESSORS |= 0xF << 20;
    __asm__ volatile("dsb\n isb");
#endif
    for (uint32_t *to = data_begin, *from = data_from; to < data_end;) *to++ = *from++;
    for (uint32_t *to = bss_begin; to < bss_end;) *to++ = 0;
    for (volatile uint32_t *to = stack_begin; to < (uint32_t *)__builtin_frame_address(0) - 16;)
        *to++ = PAINT;
    setup();
    main();
    for (;;) __asm__ volatile("wfi");
}

static void stop(void)
{
    for (;;) __asm__ volatile("wfi");
}

__attribute__((section(".vectors"), used)) static void *const vectors[16] = {stack_end, _start, stop, stop,
                                                                             stop,      stop,   stop};

int32_t board_read(uint8_t *to, int32_t n)
{
    int32_t i = 0;
    for (; i < n && UART->state & CAME; i++) to[i] = (uint8_t)UART->data;
    UART->interrupt = BOTH, PENDING = UART_BIT;
    return i;
}

void board_write(const uint8_t *from, int32_t n)
{
    for (int32_t i = 0; i < n; i++) {
        while (UART->state & SENDING) {}
        UART->data = from[i];
    }
}

int64_t board_time_ns(void)
{
    static uint32_t before;
    static int64_t ticks;
    const uint32_t now = UINT32_MAX - CLOCK->value;
    ticks += (uint32_t)(now - before);
    before = now;
    return ticks * TICK_NS;
}

void board_sleep(int64_t until_ns)
{
    const int64_t left = (until_ns - board_time_ns()) / TICK_NS;
    if (left < 100 || UART->state & CAME) return;
    ALARM->control = 0;
    ALARM->interrupt = 1, PENDING = ALARM_BIT;
    ALARM->value = left < UINT32_MAX / 2 ? (uint32_t)left : UINT32_MAX / 2;
    ALARM->control = ON_INTERRUPT;
    __asm__ volatile("wfi");
}

uint32_t board_stack(void)
{
    const uint32_t *at = stack_begin;
    while (at < stack_end && *at == PAINT) at++;
    return (uint32_t)((const char *)stack_end - (const char *)at);
}

/* Semihosting's exit, where QEMU has it on; else it stands still. */
void board_end(void) { stop(); }
