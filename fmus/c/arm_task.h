/* arm_task.h - the reference of the law in the coordinates of the arm's tip; equations in
 * fmus/models/arm_task.py.
 *
 *     v = J# z / scale + (1 - J# J) psi,   a = dv/dt,   J# = J^T (J J^T + mu^2)^-1
 *
 * J and mu are those of the coordinates before they are scaled. A row of `frame` that is 0 stands for
 * a coordinate that the arm does not have.
 *
 * Included by arm_law.h.
 */
#ifndef ARM_TASK_H
#define ARM_TASK_H

#include "chain_tip.h"
#include "contact.h"

/* Rows of J and dJ, and for each whether the arm has this coordinate. */
typedef struct {
    double J[STATES][JOINTS], dJ[STATES][JOINTS];
    int has[STATES];
} Rows;

typedef double Square[STATES][STATES];

/* x, dx and the rows of J of the tip. */
static inline void coordinates(const Model *x, const Chain *chain, const Pose *pose, Law *y,
                               Rows *rows) {
    Tip at;
    chain_tip(chain, pose, x->tip, x->dq, &at);
    for (int c = 0; c < STATES; c++) {
        const double *F = x->frame[c];
        const double place[3] = {at.p[0] - x->x_0[0], at.p[1] - x->x_0[1], at.p[2] - x->x_0[2]};
        y->x[c] = x->scale * (F[0] * place[0] + F[1] * place[1] + F[2] * place[2]);
        y->dx[c] = x->scale * (F[0] * at.dp[0] + F[1] * at.dp[1] + F[2] * at.dp[2]);
        rows->has[c] = F[0] != 0.0 || F[1] != 0.0 || F[2] != 0.0;
        for (int i = 0; i < JOINTS; i++) {
            rows->J[c][i] = F[0] * at.J[0][i] + F[1] * at.J[1][i] + F[2] * at.J[2][i];
            rows->dJ[c][i] = F[0] * at.dJ[0][i] + F[1] * at.dJ[1][i] + F[2] * at.dJ[2][i];
        }
    }
}

static inline double along(const double *row, const double *joints) {
    double sum = 0.0;
    for (int i = 0; i < JOINTS; i++) sum += row[i] * joints[i];
    return sum;
}

static inline double along_states(const double *row, const double *states) {
    double sum = 0.0;
    for (int c = 0; c < STATES; c++) sum += row[c] * states[c];
    return sum;
}

/* A = J J^T, with 1 in the place of coordinates that are missing, and its rate. */
static inline void gram(const Rows *rows, Square A, Square dA) {
    for (int c = 0; c < STATES; c++)
        for (int d = 0; d <= c; d++) {
            A[c][d] = A[d][c] = along(rows->J[c], rows->J[d]);
            dA[c][d] = dA[d][c] =
                along(rows->dJ[c], rows->J[d]) + along(rows->J[c], rows->dJ[d]);
        }
    for (int c = 0; c < STATES; c++)
        if (!rows->has[c]) A[c][c] = 1.0;
}

/* B = (A + shift)^-1 of a symmetric A with a positive result, by elimination without pivots. */
static inline void inverse_of(Square A, double shift, Square B) {
    for (int c = 0; c < STATES; c++)
        for (int d = 0; d < STATES; d++) B[c][d] = A[c][d] + (c == d ? shift : 0.0);
    for (int k = 0; k < STATES; k++) {
        const double pivot = 1.0 / B[k][k];
        B[k][k] = 1.0;
        for (int d = 0; d < STATES; d++) B[k][d] *= pivot;
        for (int c = 0; c < STATES; c++) {
            if (c == k) continue;
            const double factor = B[c][k];
            B[c][k] = 0.0;
            for (int d = 0; d < STATES; d++) B[c][d] -= factor * B[k][d];
        }
    }
}

/* mu^2 and its rate; `sigma` is set to (sum of 1/sigma_k^2)^(-1/2) over the singular values of J. */
static inline double damping_of(const Model *x, const Rows *rows, Square A, Square dA,
                                double *sigma, double *rate) {
    const double limit = x->sigma_0 * x->sigma_0;
    Square B;
    double sum = 0.0, sum_rate = 0.0;
    inverse_of(A, 1e-6 * limit, B);
    for (int c = 0; c < STATES; c++)
        if (rows->has[c]) sum += B[c][c];
    const double squared = sum > 0.0 ? 1.0 / sum : 0.0;
    const double missing = 1.0 - squared / limit;
    *sigma = squared > 0.0 ? square_root(squared) : 0.0;
    *rate = 0.0;
    if (!(missing > 0.0) || !(sum > 0.0)) return 0.0;
    for (int c = 0; c < STATES; c++)
        for (int d = 0; d < STATES; d++)
            for (int e = 0; e < STATES; e++) sum_rate -= B[c][d] * dA[d][e] * B[e][c];
    *rate = 0.5 * missing * squared * squared * sum_rate;
    return 0.25 * limit * missing * missing;
}

/* psi of joint i, rad/s, and its rate: towards the posture q_n, and away from the limits. */
static inline double wished(const Model *x, int i, double *rate) {
    const double above = x->q[i] - (x->q_max[i] - x->margin[i]);
    const double below = x->q_min[i] + x->margin[i] - x->q[i];
    const double over = above > 0.0 ? above : 0.0, under = below > 0.0 ? below : 0.0;
    const double k_l = x->k_l[i] / x->margin[i];
    const double u = x->k_n[i] * (x->q[i] - x->q_n[i]) + k_l * (over * over - under * under);
    const double slope = x->k_n[i] + 2.0 * k_l * (over + under);
    const double part = 1.0 / (1.0 + (u < 0.0 ? -u : u) / x->psi_max[i]);
    *rate = -slope * part * part * x->dq[i];
    return -u * part;
}

/* v and a of z and dz: v = psi + J^T k with (J J^T + mu^2) k = z / scale - J psi. */
static inline void joint_reference(const Model *x, const Rows *rows, const double *z, Law *y) {
    double psi[JOINTS], dpsi[JOINTS], wanted[STATES], rate[STATES], k[STATES], dk[STATES], mu2_rate;
    Square A, dA, B;
    for (int i = 0; i < JOINTS; i++) psi[i] = wished(x, i, &dpsi[i]);
    gram(rows, A, dA);
    const double mu2 = damping_of(x, rows, A, dA, &y->sigma, &mu2_rate);
    inverse_of(A, mu2, B);
    for (int c = 0; c < STATES; c++) wanted[c] = z[c] / x->scale - along(rows->J[c], psi);
    for (int c = 0; c < STATES; c++) k[c] = along_states(B[c], wanted);
    for (int c = 0; c < STATES; c++)
        rate[c] = y->dz[c] / x->scale - along(rows->dJ[c], psi) - along(rows->J[c], dpsi) -
                  along_states(dA[c], k) - mu2_rate * k[c];
    for (int c = 0; c < STATES; c++) dk[c] = along_states(B[c], rate);
    for (int i = 0; i < JOINTS; i++) {
        y->v[i] = psi[i];
        y->a[i] = dpsi[i];
        for (int c = 0; c < STATES; c++) {
            y->v[i] += rows->J[c][i] * k[c];
            y->a[i] += rows->dJ[c][i] * k[c] + rows->J[c][i] * dk[c];
        }
    }
}

static inline void refer(const Model *x, const Chain *chain, const Pose *pose, const double *z,
                         Law *y) {
    Rows rows;
    coordinates(x, chain, pose, y, &rows);
    for (int c = 0; c < STATES; c++) {
        y->xi[c] = y->dx[c] + x->alpha * y->x[c];
        y->dz[c] = -x->alpha * y->dx[c] + x->lambda_M * (y->dx[c] - z[c]) -
                   (rows.has[c] ? coupling(x, c, y->xi[c]) : 0.0);
    }
    joint_reference(x, &rows, z, y);
    for (int i = 0; i < JOINTS; i++) {
        y->s[i] = x->dq[i] - y->v[i];
        y->feedback[i] = x->K[i] * y->s[i];
    }
    for (int c = 0; c < STATES; c++) {
        const double force = x->scale * x->scale * x->K_x[c] * along(rows.J[c], y->s);
        for (int i = 0; i < JOINTS; i++) y->feedback[i] += rows.J[c][i] * force;
    }
}

/* What a model with a task gives besides. */
static inline void give_task(Model *x, const Law *y) {
    for (int c = 0; c < STATES; c++) x->x[c] = y->x[c];
    x->sigma = y->sigma;
}

static inline const char *task_problem(const Model *x) {
    int rows = 0;
    for (int c = 0; c < STATES; c++)
        rows |= x->frame[c][0] != 0.0 || x->frame[c][1] != 0.0 || x->frame[c][2] != 0.0;
    return rows ? NULL : "every row of `frame` is 0: the arm would have no coordinate";
}

#endif
