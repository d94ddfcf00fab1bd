/* chain.c: dynamics of a serial arm and functions of others, called many times without Python.
 *
 * Each call changes an input by the result of the one before, so that none can be left out.
 */
#include "chain_forward.h"
#include "export.h"

typedef const char *step_f(double *, double, double);
typedef void mujoco_f(const void *, void *);

static Chain view(int n, double *const *t)
{
    const Chain chain = {n, t[0], t[1], t[2], t[3], t[4], t[5]};
    return chain;
}

EXPORT void forward(int n, double *const *t, double *q, double *dq, double *tau, double *ddq, int times)
{
    const Chain chain = view(n, t);
    for (int i = 0; i < times; i++) {
        chain_forward(&chain, q, dq, tau, ddq);
        q[0] += 1e-12 * ddq[n - 1];
    }
}

EXPORT void inverse(int n, double *const *t, double *q, double *dq, double *ddq, double *tau, int times)
{
    const Chain chain = view(n, t);
    for (int i = 0; i < times; i++) {
        chain_inverse(&chain, q, dq, ddq, tau);
        q[0] += 1e-12 * tau[n - 1];
    }
}

/* A kernel of a model, as an FMU or the engine steps it; the steps of a plant move it. */
EXPORT int steps(step_f *step, double *x, double h, int times)
{
    for (int i = 0; i < times; i++)
        if (step(x, i * h, h)) return 0;
    return 1;
}

EXPORT void mujoco(mujoco_f *call, const void *model, void *data, int times)
{
    for (int i = 0; i < times; i++) call(model, data);
}
