/* grasp.c - when a hand holds the arm: a signal of 0 and 1 that changes at given times. */
#include <stddef.h>

#include "model.h"
#include "schedule.h"

enum { TIMES = ENTRIES(times) };

static void give(Model *x, double t, double h)
{
    int off = x->released != 0.0;
    for (int i = 0; i < TIMES; i++) off ^= reached(t, h, x->times[i]);
    x->grip = off ? 0.0 : 1.0;
}

GIVEN_AT_EACH_STEP
