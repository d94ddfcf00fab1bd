/* cortex_m.c - Cortex-M on the boards mps2-an386 and mps2-an500: reset, console, count of instructions.
 *
 * The console is semihosting, which emulators and debuggers offer. TIMER0 of these boards counts down with
 * 25 MHz; in QEMU with -icount shift=10, it does so by the number of instructions.
 */
#include "board.h"

#define CPACR (*(volatile uint32_t *)0xE000ED88u)
#define TIMER0 ((volatile uint32_t *)0x40000000u) /* control, value, reload */

enum { SYS_WRITE0 = 0x04, SYS_EXIT_EXTENDED = 0x20, STOPPED_APPLICATION_EXIT = 0x20026 };

extern const uint32_t stack_top[];
extern const uint32_t data_stored[];
extern uint32_t data_start[], data_end[], bss_start[], bss_end[];

int main(void);
void _start(void);
static void fault(void);

typedef void Handler(void);
__attribute__((section(".vectors"), used)) static Handler *const vectors[16] = {
    (Handler *)(uintptr_t)stack_top, _start, fault, fault, fault, fault, fault};

static void semihosting(int operation, const void *argument)
{
    register int r0 __asm__("r0") = operation;
    register const void *r1 __asm__("r1") = argument;
    __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
}

void board_write(const char *text) { semihosting(SYS_WRITE0, text); }

void board_end(int code)
{
    const uint32_t block[2] = {STOPPED_APPLICATION_EXIT, (uint32_t)code};
    semihosting(SYS_EXIT_EXTENDED, block);
    for (;;) continue;
}

uint32_t board_count(void) { return ~TIMER0[1]; }

static void fault(void)
{
    board_write("fault\n");
    board_end(3);
}

void _start(void)
{
    const uint32_t *from = data_stored;
    for (uint32_t *to = data_start; to < data_end; to++) *to = *from++;
    for (uint32_t *to = bss_start; to < bss_end; to++) *to = 0;
    CPACR |= 0xFu << 20; /* the floating-point unit, where there is one */
    __asm__ volatile("dsb\n isb" ::: "memory");
    TIMER0[2] = TIMER0[1] = UINT32_MAX;
    TIMER0[0] = 1;
    board_end(main());
}
