/* check.c - STEPS steps of MODEL with inputs that change at random, and a digest of all variables at all steps.
 *
 * It prints one line; the digest is that of the FMU, or one of the two has a mistake.
 */
#include "MODEL.h"
#include "board.h"

#ifndef STEPS
#define STEPS 1000
#endif

enum { SCALARS = sizeof(MODEL_t) / sizeof(double), EACH = 7 };

static const struct {
    unsigned first, size;
} inputs[] = INPUT_RANGES;

static union {
    MODEL_t model;
    double scalars[SCALARS];
    uint64_t bits[SCALARS];
} x;

static uint64_t digest = 0xcbf29ce484222325u; /* FNV-1a, a number at a time */

static void take(uint64_t bits)
{
    digest = (digest ^ bits) * 0x100000001b3u;
    digest ^= digest >> 29;
}

/* The next of a sequence of numbers from -1 to 1. */
static double number(void)
{
    static uint64_t state = 1;
    state = state * 6364136223846793005u + 1442695040888963407u;
    return (double)(int64_t)(state >> 11) * 0x1p-52 - 1.0;
}

static void change_inputs(void)
{
    for (unsigned i = 0; i < sizeof inputs / sizeof inputs[0]; i++)
        for (unsigned k = 0; k < inputs[i].size; k++) x.scalars[inputs[i].first + k] += 0.25 * number();
}

static char line[160];
static unsigned length;

static void put(const char *text)
{
    while (*text) line[length++] = *text++;
}

static void put_number(uint64_t value, unsigned base, unsigned digits)
{
    char reversed[24];
    unsigned n = 0;
    do {
        reversed[n++] = "0123456789abcdef"[value % base];
        value /= base;
    } while (value || n < digits);
    while (n) line[length++] = reversed[--n];
}

static uint64_t instructions(uint32_t ticks)
{
    return ((uint64_t)ticks * BOARD_INSTRUCTIONS + BOARD_TICKS / 2) / BOARD_TICKS;
}

int main(void)
{
    uint64_t sum = 0, most = 0, failed = 0;
    uint32_t before = board_count();
    const uint64_t own = instructions(board_count() - before); /* of reading the counter */

    if (MODEL_init(&x.model)) return board_write("MODEL_init failed\n"), 1;
    board_paint();
    for (int i = 0; i < STEPS; i++) {
        if (i % EACH == 0) change_inputs();
        before = board_count();
        const char *why = MODEL_step(&x.model, i * MODEL_STEP, MODEL_STEP);
        const uint64_t taken = instructions(board_count() - before) - own;
        sum += taken;
        if (taken > most) most = taken;
        for (unsigned k = 0; k < SCALARS; k++) take(x.bits[k]);
        if (why) failed++, (void)MODEL_init(&x.model); /* with these inputs it cannot go on */
    }
    put("digest "), put_number(digest, 16, 16);
    put(" steps "), put_number(STEPS, 10, 1);
    put(" refused "), put_number(failed, 10, 1);
    put(" instructions "), put_number(sum / STEPS, 10, 1);
    put(" most "), put_number(most, 10, 1);
    put(" stack "), put_number(board_stack(), 10, 1);
    put("\n");
    board_write(line);
    return 0;
}
