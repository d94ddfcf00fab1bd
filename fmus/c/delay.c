/* delay.c - a link: all samples are stored, and a table says which one has arrived at each step.
 *
 *     y_(k+1) = u_(held_(k+1)), or y_0 as long as held_(k+1) = -1
 */
#include <stddef.h>

#include "model.h"

#include "delay_table.h"

/* Index of the sample held at step k, from the table. After the end of the table the age stays constant. */
static long held_at(long k)
{
    if (DELAY > 0) return k >= DELAY ? k - DELAY : -1;
    if (k < ROWS) return held[k];
    return held[ROWS - 1] < 0 ? -1 : held[ROWS - 1] + (k - (ROWS - 1));
}

const char *model_initial(Model *x)
{
    if (!all_finite(x->u, WIDTH)) return "the input left the range of numbers";
    for (int i = 0; i < WIDTH; i++) x->y[i] = x->before[i] = HAS_INITIAL ? initial[i] : x->u[i];
    for (int i = 0; i < WIDTH * CAPACITY; i++) x->sent[i] = 0.0;
    x->k = 0.0;
    return NULL;
}

const char *model_step(Model *x, double t, double h)
{
    (void)t, (void)h; /* counted in steps */
    if (!all_finite(x->u, WIDTH)) return "the input left the range of numbers";
    long k = (long)x->k, row = held_at(k + 1);
    for (int i = 0; i < WIDTH; i++) x->sent[(k % CAPACITY) * WIDTH + i] = x->u[i];
    for (int i = 0; i < WIDTH; i++) x->y[i] = row < 0 ? x->before[i] : x->sent[(row % CAPACITY) * WIDTH + i];
    x->k = (double)(k + 1);
    return NULL;
}
