/* schedule.h - moments of a plan met at sampling instants. */
#ifndef SCHEDULE_H
#define SCHEDULE_H

/* Whether at t (s) a moment has come; t may be a millionth of the step h (s) short of it, since
 * t = k h is rounded. */
static inline int reached(double t, double h, double moment) { return t + 1e-6 * h >= moment; }

/* The functions of a model whose outputs `give(x, t, h)` computes at each sampling instant. */
#define GIVEN_AT_EACH_STEP                                \
    const char *model_initial(Model *x) {                 \
        give(x, 0.0, 0.0);                                \
        return NULL;                                      \
    }                                                     \
    const char *model_step(Model *x, double t, double h) { \
        give(x, t, h);                                    \
        return NULL;                                      \
    }

#endif
