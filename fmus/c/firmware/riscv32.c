/* riscv32.c - RISC-V on the board `virt` of QEMU: start, console, count of instructions.
 *
 * The console is semihosting, which emulators and debuggers offer. The counter minstret counts
 * instructions in QEMU with -icount shift=0.
 */
#include "board.h"

enum { SYS_WRITE0 = 0x04, SYS_EXIT_EXTENDED = 0x20, STOPPED_APPLICATION_EXIT = 0x20026 };

extern uint32_t bss_start[], bss_end[];

int main(void);
void _start(void);

/* The three instructions must not be compressed and must lie in one page. */
__attribute__((naked, noinline, aligned(16))) static void semihosting(int operation, const void *argument)
{
    __asm__ volatile(".option push\n .option norvc\n"
                     "slli x0, x0, 0x1f\n ebreak\n srai x0, x0, 7\n ret\n"
                     ".option pop");
}

void board_write(const char *text) { semihosting(SYS_WRITE0, text); }

void board_end(int code)
{
    const uint32_t block[2] = {STOPPED_APPLICATION_EXIT, (uint32_t)code};
    __asm__ volatile("" ::"r"(block) : "memory");
    semihosting(SYS_EXIT_EXTENDED, block);
    for (;;) continue;
}

/* csrr minstret, as a number: compilers name the extension of this instruction differently. */
uint32_t board_count(void)
{
    uint32_t count;
    __asm__ volatile(".insn i 0x73, 2, %0, x0, -1278" : "=r"(count)::"memory");
    return count;
}

__attribute__((used)) static void begin(void)
{
    for (uint32_t *to = bss_start; to < bss_end; to++) *to = 0;
    board_end(main());
}

__attribute__((used, aligned(4))) static void fault(void)
{
    board_write("fault\n");
    board_end(3);
}

/* The third instruction is csrw mtvec, t0. */
__attribute__((naked, section(".start"))) void _start(void)
{
    __asm__ volatile("la sp, stack_top\n la t0, fault\n .insn i 0x73, 1, x0, t0, 0x305\n tail begin");
}
