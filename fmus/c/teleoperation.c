/* teleoperation.c - the adaptive law of the paper, eqs (29)-(32), (42)-(45), (61) and (76)-(81), for
 * the planar arm; equations in fmus/models/teleoperation.py.
 *
 *     tau = -K s + Y(q, dq, z, dz) theta_hat,   dtheta_hat = -Gamma Y^T s,   s = dq - z
 *     dz  = -alpha dq + lambda_M (dq - z) - lambda sum_j w_j (xi - xi_in_j)
 *
 * The law is sampled: the outputs are those of t_k. The state for t_k + h is kept in z_next and
 * theta_hat_next until the next step.
 *
 * Which variables there are is in the declaration of the model (`defines`):
 *     NETWORKED  1: neighbours (xi_in, w, age, lambda, age_max, age_fade), 0: one arm alone
 *     GRAVITY    1: two parameters of gravity in theta_hat (theta_g, gravity), 0: none
 */
#include <stddef.h>

#include "limit.h"
#include "model.h"
#include "neighbours.h"
#include "regressor.h"

enum { P = ENTRIES(theta_hat) };

typedef struct {
    Real xi[2], dz[2], s[2], tau[2];
    Real Ys[P]; /* Y^T s */
    Truth saturated, stale;
} Law;

/* --- gravity ------------------------------------------------------------------------------ */

#if GRAVITY
enum { NO_GRAVITY, COMPENSATED, ADAPTED };

/* The two columns of Y with gravity, (cos q1, 0) and (cos q12, cos q12), q12 = q1 + q2. */
static inline void add_gravity(const Model *x, const Real theta_hat[P], const Real s[2], Real tau[2],
                               Real Ys[P])
{
    const int mode = (int)COMMON(x->gravity);
    const Real *gamma = mode == ADAPTED ? theta_hat + 3 : x->theta_g, none = {0.0};
    Real s1, c1, s12, c12;
    Ys[3] = Ys[4] = none;
    if (mode == NO_GRAVITY) return;
    sine_cosine(x->q[0], &s1, &c1);
    sine_cosine(x->q[0] + x->q[1], &s12, &c12);
    tau[0] += c1 * gamma[0] + c12 * gamma[1];
    tau[1] += c12 * gamma[1];
    if (mode == COMPENSATED) return;
    Ys[3] = c1 * s[0];
    Ys[4] = c12 * (s[0] + s[1]);
}
#else
static inline void add_gravity(const Model *x, const Real theta_hat[P], const Real s[2], Real tau[2],
                               Real Ys[P])
{
    (void)x, (void)theta_hat, (void)s, (void)tau, (void)Ys;
}
#endif

/* --- gains that are matrices ---------------------------------------------------------------- */

/* Entry (i, j) of Gamma. Gamma_off holds the entries right of the diagonal, row by row. */
static inline Real gamma_entry(const Model *x, int i, int j)
{
    const int row = i < j ? i : j, column = i < j ? j : i;
    if (i == j) return x->Gamma[i];
    return x->Gamma_off[row * P - row * (row + 1) / 2 + column - row - 1];
}

/* Entry i of Gamma Y^T s. */
static inline Real adaptation(const Model *x, const Real Ys[P], int i)
{
    Real rate = x->Gamma[i] * Ys[i];
    for (int j = 0; j < P; j++)
        if (j != i) rate += gamma_entry(x, i, j) * Ys[j];
    return rate;
}

/* --- the law ------------------------------------------------------------------------------ */

/* The law as of t_k, with the state z, theta_hat. */
static inline void law(const Model *x, const Real z[2], const Real theta_hat[P], Law *y)
{
    const Real *q = x->q, *dq = x->dq, *s = y->s;
    const Truth inertial = x->lambda_c > 0.0; /* Remark 3: K = lambda_c M_hat, inside Y */
    const Real K_off = PICK(inertial, 0.0, x->K_off);
    Real a[2], K[2];
    for (int i = 0; i < 2; i++) {
        y->xi[i] = dq[i] + x->alpha * q[i];
        y->dz[i] = -x->alpha * dq[i] + x->lambda_M * (dq[i] - z[i]) - coupling(x, i, y->xi[i]);
        y->s[i] = dq[i] - z[i];
        a[i] = PICK(inertial, y->dz[i] - x->lambda_c * y->s[i], y->dz[i]);
        K[i] = PICK(inertial, 0.0, x->K[i]);
    }
    const Regressor Y = regressor(q, dq, z, a);
    Real tau[2] = {-(K[0] * s[0] + K_off * s[1]) + Y.Y11 * theta_hat[0] + Y.Y12 * theta_hat[1] +
                       Y.Y13 * theta_hat[2],
                   -(K[1] * s[1] + K_off * s[0]) + Y.Y22 * theta_hat[1] + Y.Y23 * theta_hat[2]};
    transposed_times(&Y, s, y->Ys);
    add_gravity(x, theta_hat, s, tau, y->Ys);
    for (int i = 0; i < 2; i++) y->tau[i] = limited(tau[i], x->tau_max[i]);
    y->saturated = (y->tau[0] != tau[0]) | (y->tau[1] != tau[1]);
    y->stale = any_stale(x);
}

static inline int finite_law(const Law *y)
{
    return all_finite(y->tau, 2) && all_finite(y->xi, 2) && all_finite(y->s, 2) && all_finite(y->dz, 2) &&
           all_finite(y->Ys, P);
}

static inline void give(Model *x, const Law *y)
{
    for (int i = 0; i < 2; i++) {
        x->tau[i] = y->tau[i];
        x->xi[i] = y->xi[i];
        x->s[i] = y->s[i];
    }
}

#if TOGETHER == 1
static inline int any_off(const Model *x)
{
    int any = 0;
    for (int i = 0; i < P * (P - 1) / 2; i++) any |= x->Gamma_off[i] != 0.0;
    return any;
}

/* Whether Gamma = L D L^T with D > 0. */
static inline int gamma_is_positive(const Model *x)
{
    double L[P][P], D[P];
    for (int i = 0; i < P; i++) {
        for (int j = 0; j <= i; j++) {
            double rest = gamma_entry(x, i, j);
            for (int k = 0; k < j; k++) rest -= L[i][k] * L[j][k] * D[k];
            if (j == i) D[i] = rest;
            else L[i][j] = rest / D[j];
        }
        if (!(D[i] > 0.0)) return 0;
    }
    return 1;
}

static inline int is_bounded(const Model *x)
{
    int bounded = 0;
    for (int i = 0; i < P; i++) bounded |= x->theta_min[i] > -1e9 || x->theta_max[i] < 1e9;
    return bounded;
}

/* Checks of values that depend on several variables, which a minimum or maximum cannot express. */
static inline const char *check(const Model *x)
{
    if (x->K_off != 0.0 && !(x->K[0] > 0.0 && x->K[0] * x->K[1] > x->K_off * x->K_off))
        return "K with K_off is not positive definite";
    if (any_off(x) && !gamma_is_positive(x)) return "Gamma with Gamma_off is not positive definite";
    if (any_off(x) && is_bounded(x))
        return "theta_min and theta_max are bounded while Gamma_off is not 0: expected a diagonal";
    for (int i = 0; i < P; i++)
        if (!(x->theta_min[i] <= x->theta_hat[i] && x->theta_hat[i] <= x->theta_max[i]))
            return "theta_hat starts outside of theta_min ... theta_max";
#if NETWORKED
    if (!(x->alpha > 0.0)) return "alpha must be more than 0 with neighbours: positions would not agree";
#endif
#if GRAVITY
    if (!(x->gravity >= NO_GRAVITY && x->gravity <= ADAPTED)) return "gravity must be 0, 1 or 2";
#endif
    return NULL;
}

const char *model_initial(Model *x)
{
    Law y;
    const char *why = check(x);
    if (why != NULL) return why;
    law(x, x->z, x->theta_hat, &y);
    if (!finite_law(&y)) return LAW_DIVERGED;
    give(x, &y);
    for (int i = 0; i < 2; i++) x->z_next[i] = x->z[i];
    for (int i = 0; i < P; i++) x->theta_hat_next[i] = x->theta_hat[i];
    return NULL;
}
#endif

const char *model_step(Model *x, double t, double h)
{
    Law y;
    (void)t; /* the law does not depend on time */
    law(x, x->z_next, x->theta_hat_next, &y);
    if (!finite_law(&y)) return LAW_DIVERGED;
    give(x, &y);
    const Real advance = PICK(y.saturated, 0.0, h); /* anti-windup */
    const Real adapt = PICK(y.stale, 0.0, advance);
    for (int i = 0; i < 2; i++) {
        x->z[i] = x->z_next[i];
        x->z_next[i] += advance * y.dz[i];
    }
    for (int i = 0; i < P; i++) {
        const Real theta_hat = x->theta_hat_next[i] - adapt * adaptation(x, y.Ys, i);
        x->theta_hat[i] = x->theta_hat_next[i];
        x->theta_hat_next[i] = clipped(theta_hat, x->theta_min[i], x->theta_max[i]);
    }
    return NULL;
}
