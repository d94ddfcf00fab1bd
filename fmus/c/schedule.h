/* schedule.h - whether a given time has been reached at a sampling instant. */
#ifndef SCHEDULE_H
#define SCHEDULE_H

/* Whether the time is reached at t, in s. It also counts as reached if t is less than a millionth of the
 * step h earlier, because t = k h is rounded. */
static inline int reached(double t, double h, double moment) { return t + 1e-6 * h >= moment; }

/* The functions of a model whose outputs `give(x, t, h)` computes at each sampling instant. */
#define GIVEN_AT_EACH_STEP                               \
    const char *model_initial(Model *x)                  \
    {                                                    \
        give(x, 0.0, 0.0);                               \
        return NULL;                                     \
    }                                                    \
    const char *model_step(Model *x, double t, double h) \
    {                                                    \
        give(x, t, h);                                   \
        return NULL;                                     \
    }

#endif
