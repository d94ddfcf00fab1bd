/* stiff.h - how many steps the classical Runge-Kutta method needs where friction and stops are stiff;
 * fmus/arms/stiff.py has the same in Python.
 */
#ifndef STIFF_H
#define STIFF_H

/* The method is stable while the fastest rate of an oscillation or a decay times the step is below 2.78, and
 * below this in every direction between. */
static const double BEARABLE = 2.5;

enum { MOST_STEPS = 1000 };

/* The least whole number that is at least x and `least`, -1 for more than MOST_STEPS and `least`. */
static inline double whole(double x, double least)
{
    if (x <= least) return least;
    if (!(x <= MOST_STEPS)) return -1.0;
    const double below = (int)x;
    return below + (below < x);
}

#endif
