/* arm_task.h - the reference of the law in the coordinates of the arm's tip; equations in
 * fmus/models/arm_task.py.
 *
 *     v = J# z + (1 - J# J) psi,   a = dv/dt,   J# = J^T (J J^T + mu^2)^-1
 *
 * J and mu here are those of the coordinates before they are scaled by SCALE.
 *
 * Included by arm_teleoperation.c. TURN is 1 for six coordinates, three of the place and three of the turn.
 */
#ifndef ARM_TASK_H
#define ARM_TASK_H

#include "chain_tip.h"
#include "contact.h"
#if TURN
#include "tip_turn.h"
#endif

enum { PLACE = ENTRIES(frame) / 3 };

/* Of coordinate c: a turn has the same size in every arm. */
#define SCALE(x, c) ((c) < PLACE ? (x)->scale : 1.0)

/* Rows of J and dJ; those of a coordinate that the arm lacks are 0. */
typedef struct {
    double J[STATES][JOINTS], dJ[STATES][JOINTS];
} Rows;

typedef double Square[STATES][STATES];

static inline int has(const Model *x, int c) { return x->lacks[c] == 0.0; }

/* `row` = F times the rows of a (3, CHAIN_MOST). */
static inline void combined(const double F[3], double a[][CHAIN_MOST], double *row)
{
    for (int i = 0; i < JOINTS; i++) row[i] = F[0] * a[0][i] + F[1] * a[1][i] + F[2] * a[2][i];
}

static inline double along(const double *row, const double *joints)
{
    double sum = 0.0;
    for (int i = 0; i < JOINTS; i++) sum += row[i] * joints[i];
    return sum;
}

static inline double along_states(const double *row, const double *states)
{
    double sum = 0.0;
    for (int c = 0; c < STATES; c++) sum += row[c] * states[c];
    return sum;
}

/* x and the rows of J, dJ of the tip. */
static inline void coordinates(const Model *x, const Chain *chain, const Pose *pose, Law *y, Rows *rows)
{
    Tip at;
    chain_tip(chain, pose, x->tip, x->dq, &at);
    const double place[3] = {at.p[0] - x->x_0[0], at.p[1] - x->x_0[1], at.p[2] - x->x_0[2]};
    for (int c = 0; c < PLACE; c++) {
        const double *F = x->frame[c];
        y->x[c] = x->scale * (F[0] * place[0] + F[1] * place[1] + F[2] * place[2]);
        combined(F, at.J, rows->J[c]);
        combined(F, at.dJ, rows->dJ[c]);
    }
#if TURN
    Turn turn;
    turn_of(&at, x->frame[0], x->R_0[0], &turn);
    for (int c = 0; c < 3; c++) {
        const double *B = turn.B + 3 * c, *dB = turn.dB + 3 * c;
        double part[JOINTS];
        y->x[PLACE + c] = x->length * turn.x[c];
        combined(B, at.J + 3, rows->J[PLACE + c]);
        combined(B, at.dJ + 3, rows->dJ[PLACE + c]);
        combined(dB, at.J + 3, part);
        for (int i = 0; i < JOINTS; i++) {
            rows->J[PLACE + c][i] *= x->length;
            rows->dJ[PLACE + c][i] = x->length * (rows->dJ[PLACE + c][i] + part[i]);
        }
    }
#endif
    for (int c = 0; c < STATES; c++) {
        if (!has(x, c)) y->x[c] = 0.0;
        for (int i = 0; i < JOINTS && !has(x, c); i++) rows->J[c][i] = rows->dJ[c][i] = 0.0;
    }
}

/* A = J J^T, with 1 in the place of coordinates that are missing, and its rate. */
static inline void gram(const Model *x, const Rows *rows, Square A, Square dA)
{
    for (int c = 0; c < STATES; c++)
        for (int d = 0; d <= c; d++) {
            A[c][d] = A[d][c] = along(rows->J[c], rows->J[d]);
            dA[c][d] = dA[d][c] = along(rows->dJ[c], rows->J[d]) + along(rows->J[c], rows->dJ[d]);
        }
    for (int c = 0; c < STATES; c++)
        if (!has(x, c)) A[c][c] = 1.0;
}

/* B = (A + shift)^-1 of a symmetric A with a positive result, by elimination without pivots. */
static inline void inverse_of(Square A, double shift, Square B)
{
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
static inline double damping_of(const Model *x, Square A, Square dA, double *sigma, double *rate)
{
    const double limit = x->sigma_0 * x->sigma_0;
    Square B;
    double sum = 0.0, sum_rate = 0.0;
    inverse_of(A, 1e-6 * limit, B);
    for (int c = 0; c < STATES; c++)
        if (has(x, c)) sum += B[c][c];
    /* without what made the inverse exist: at most the square of the smallest, and 0 where that is */
    const double shifted = sum > 0.0 ? 1.0 / sum : 0.0, beyond = shifted - 1e-6 * limit;
    const double squared = beyond > 0.0 ? beyond : 0.0;
    const double missing = 1.0 - squared / limit;
    *sigma = squared > 0.0 ? square_root(squared) : 0.0;
    *rate = 0.0;
    if (!(missing > 0.0) || !(sum > 0.0)) return 0.0;
    for (int c = 0; c < STATES; c++)
        for (int d = 0; d < STATES; d++)
            for (int e = 0; e < STATES; e++) sum_rate -= B[c][d] * dA[d][e] * B[e][c];
    *rate = beyond > 0.0 ? 0.5 * missing * shifted * shifted * sum_rate : 0.0;
    return 0.25 * limit * missing * missing;
}

/* psi of joint i, rad/s, and its rate: towards the posture q_n, and away from the limits. */
static inline double wished(const Model *x, int i, double *rate)
{
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

/* v and a of z and dz: v = psi + J^T k with (J J^T + mu^2) k = z / SCALE - J psi. */
static inline void joint_reference(const Model *x, const Rows *rows, const double *z, Law *y)
{
    double psi[JOINTS], dpsi[JOINTS], wanted[STATES], rate[STATES], k[STATES], dk[STATES], mu2_rate;
    Square A, dA, B;
    for (int i = 0; i < JOINTS; i++) psi[i] = wished(x, i, &dpsi[i]);
    gram(x, rows, A, dA);
    const double mu2 = damping_of(x, A, dA, &y->sigma, &mu2_rate);
    inverse_of(A, mu2, B);
    for (int c = 0; c < STATES; c++) wanted[c] = z[c] / SCALE(x, c) - along(rows->J[c], psi);
    for (int c = 0; c < STATES; c++) k[c] = along_states(B[c], wanted);
    for (int c = 0; c < STATES; c++)
        rate[c] = y->dz[c] / SCALE(x, c) - along(rows->dJ[c], psi) - along(rows->J[c], dpsi) -
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

static inline void refer(const Model *x, const Chain *chain, const Pose *pose, const double *z, Law *y)
{
    Rows rows;
    coordinates(x, chain, pose, y, &rows);
    for (int c = 0; c < STATES; c++) {
        const double dx = SCALE(x, c) * along(rows.J[c], x->dq);
        y->xi[c] = dx + x->alpha * y->x[c];
        y->dz[c] = -x->alpha * dx + x->lambda_M * (dx - z[c]) - (has(x, c) ? coupling(x, c, y->xi[c]) : 0.0);
    }
    joint_reference(x, &rows, z, y);
    for (int i = 0; i < JOINTS; i++) {
        y->s[i] = x->dq[i] - y->v[i];
        y->feedback[i] = x->K[i] * y->s[i];
    }
    for (int c = 0; c < STATES; c++) {
        const double force = SCALE(x, c) * SCALE(x, c) * x->K_x[c] * along(rows.J[c], y->s);
        for (int i = 0; i < JOINTS; i++) y->feedback[i] += rows.J[c][i] * force;
    }
}

/* What a model with a task gives besides. */
static inline void give_task(Model *x, const Law *y)
{
    for (int c = 0; c < STATES; c++) x->x[c] = y->x[c];
    x->sigma = y->sigma;
}

static inline const char *task_problem(const Model *x)
{
    int any = 0;
    for (int c = 0; c < STATES; c++) any |= has(x, c);
    if (!any) return "the arm lacks every coordinate";
#if TURN
    if (!is_rotation(x->frame[0])) return "`frame` is not a rotation matrix";
#endif
    return NULL;
}

/* What is computed once: the orientation in the posture q_0, which has the turn 0. */
static inline void begin_task(Model *x)
{
#if TURN
    const Chain chain = CHAIN_OF(x);
    Pose pose[CHAIN_MOST];
    Tip at;
    chain_pose(&chain, x->q_0, pose);
    chain_tip(&chain, pose, x->tip, x->dq, &at);
    for (int k = 0; k < 9; k++) x->R_0[k / 3][k % 3] = at.R[k];
#else
    (void)x;
#endif
}

#endif
