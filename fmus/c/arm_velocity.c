/* arm_velocity.c - the adaptive law for an arm whose servos take velocities and have unknown gains.
 *
 *     dq_c = z + Y_i theta_hat_i + own_hat_i . (dz, z)_i,   dtheta_hat_i = -Gamma_i Y_i^T s_i
 *
 * Equations in fmus/models/arm_velocity.py. Row i of Y is the gradient of the wrench of every link
 * from i on by its parameters, along the twist that a unit of joint i's velocity gives it.
 */
#define NETWORKED 1
#include <stddef.h>

#include "chain_check.h"
#include "chain_law.h"
#include "limit.h"
#include "model.h"
#include "neighbours.h"

enum { JOINTS = ENTRIES(q) };

#include "commands.h"

typedef struct {
    double xi[JOINTS], dz[JOINTS], s[JOINTS], dq_c[JOINTS], Y[JOINTS][JOINTS][10];
} Law;

/* The rows of Y, row i from link i on. */
static void rows(const Model *x, Law *y)
{
    const Chain chain = CHAIN_OF(x);
    Pose pose[CHAIN_MOST];
    LinkMotion base = {{0.0}, {0.0}, {0.0}, {0.0}}, motion[JOINTS];
    double b[JOINTS][3];
    chain_pose(&chain, x->q, pose);
    if (x->gravity == ADAPTED) base_acceleration(&chain, base.a);
    for (int j = 0; j < JOINTS; j++)
        link_motion(&chain, pose, j, j ? &motion[j - 1] : &base, x->dq, x->z_next, y->dz, &motion[j], b[j]);
    for (int i = 0; i < JOINTS; i++) {
        double sigma[6] = {0.0}, here[6];
        sigma[axis_of(&chain, i)] = 1.0;
        for (int j = i; j < JOINTS; j++) {
            if (j > i) to_link(&pose[j], sigma, here);
            for (int k = 0; k < 6; k++) {
                if (j > i) sigma[k] = here[k];
                motion[j].sigma[k] = sigma[k];
            }
            link_gradient(&motion[j], b[j], y->Y[i][j]);
        }
    }
}

/* The law as of t_k, with the states of the next step, which t_k is. */
static void law(const Model *x, Law *y)
{
    for (int i = 0; i < JOINTS; i++) {
        y->xi[i] = x->dq[i] + x->alpha * x->q[i];
        y->s[i] = x->dq[i] - x->z_next[i];
        y->dz[i] = -x->alpha * x->dq[i] + x->lambda_M * y->s[i] - coupling(x, i, y->xi[i]);
    }
    rows(x, y);
    for (int i = 0; i < JOINTS; i++) {
        const double z = x->z_next[i], *own = x->own_hat_next[i];
        double fed = own[0] * y->dz[i] + own[1] * z;
        for (int j = i; j < JOINTS; j++)
            for (int k = 0; k < 10; k++) fed += y->Y[i][j][k] * x->theta_hat_next[i][j][k];
        y->dq_c[i] = z + fed;
    }
}

/* Whether the estimates may change: no limit acts, and nothing that is received is old. */
static int may_adapt(const Model *x, const Law *y)
{
    int may = !any_stale(x);
    for (int i = 0; i < JOINTS; i++)
        may &= x->clamped[i] == 0.0 && limited(y->dq_c[i], x->v_max[i]) == y->dq_c[i];
    return may;
}

/* Take over the estimates of joint i for t_k, and compute those for t_k + h. */
static void adapt(Model *x, int i, const Law *y, double h)
{
    const double s = y->s[i], row = x->Gamma_row[i] * s;
    for (int j = 0; j < JOINTS; j++)
        for (int k = 0; k < 10; k++) {
            x->theta_hat[i][j][k] = x->theta_hat_next[i][j][k];
            if (j >= i) x->theta_hat_next[i][j][k] -= h * (row * x->Gamma[j][k]) * y->Y[i][j][k];
        }
    for (int k = 0; k < 2; k++) x->own_hat[i][k] = x->own_hat_next[i][k];
    x->own_hat_next[i][0] -= h * x->Gamma_own[i][0] * y->dz[i] * s;
    x->own_hat_next[i][1] -= h * x->Gamma_own[i][1] * x->z[i] * s;
}

const char *model_initial(Model *x)
{
    const Chain chain = CHAIN_OF(x);
    const char *problem = chain_problem(&chain);
    if (problem) return problem;
    if (!(x->alpha > 0.0)) return "alpha must be more than 0 with neighbours: positions would not agree";
    if (x->gravity != NO_GRAVITY && x->gravity != ADAPTED)
        return "gravity must be 0 or 2: a torque against it cannot be commanded";
    for (int i = 0; i < JOINTS; i++) {
        begin_command(x, i);
        x->xi[i] = x->dq[i] + x->alpha * x->q[i];
        x->s[i] = x->dq[i] - x->z[i];
        for (int j = 0; j < JOINTS; j++)
            for (int k = 0; k < 10; k++) x->theta_hat_next[i][j][k] = x->theta_hat[i][j][k];
        for (int k = 0; k < 2; k++) x->own_hat_next[i][k] = x->own_hat[i][k];
    }
    return all_finite(x->xi, JOINTS) && all_finite(x->s, JOINTS) ? NULL : LAW_DIVERGED;
}

const char *model_step(Model *x, double t, double h)
{
    Law y;
    (void)t; /* the law does not depend on time */
    law(x, &y);
    if (!all_finite(y.dq_c, JOINTS) || !all_finite(y.dz, JOINTS)) return LAW_DIVERGED;
    const double advance = may_adapt(x, &y) ? h : 0.0;
    for (int i = 0; i < JOINTS; i++) {
        x->xi[i] = y.xi[i];
        x->s[i] = y.s[i];
        x->z[i] = x->z_next[i];
        adapt(x, i, &y, advance);
        give_command(x, i, y.dq_c[i], y.dz[i], h);
    }
    return all_finite(x->theta_hat_next[0][0], JOINTS * JOINTS * 10) ? NULL : LAW_DIVERGED;
}
