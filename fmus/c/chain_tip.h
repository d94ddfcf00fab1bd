/* chain_tip.h - the tip of a serial chain in the frame of its base: place, orientation, Jacobian.
 *
 *     revolute     J_i = (a_i x (p - o_i), a_i)     a_i, o_i: axis and origin of joint i in the base
 *     prismatic    J_i = (a_i, 0)
 *
 * and dJ_i by the same formula differentiated: an axis turns with the link before its joint, and an
 * origin moves with it. Our own derivation.
 */
#ifndef CHAIN_TIP_H
#define CHAIN_TIP_H

#include "chain.h"

/* Place and velocity, m and m/s, orientation R and angular velocity, rad/s; J (6, n) of velocity and
 * angular velocity, and its rate dJ, row by row. */
typedef struct {
    double p[3], dp[3], R[9], omega[3], J[6][CHAIN_MOST], dJ[6][CHAIN_MOST];
} Tip;

/* The axis of a joint and the origin of its link in the base, and their rates. */
typedef struct {
    double axis[3], axis_rate[3], origin[3], velocity[3];
} JointInBase;

/* C = A B, both row-major. */
static inline void multiply(const double A[9], const double B[9], double C[9])
{
    UNROLLED for (int i = 0; i < 3; i++) UNROLLED for (int k = 0; k < 3; k++) C[3 * i + k] =
        A[3 * i] * B[k] + A[3 * i + 1] * B[3 + k] + A[3 * i + 2] * B[6 + k];
}

/* Tip, but for J and dJ, of the point `tip` (3,), m, of the last link; and each joint in the base. */
static inline void place_tip(const Chain *chain, const Pose *pose, const double tip[3], const double *dq,
                             JointInBase *joint, Tip *at)
{
    static const double unit[9] = {1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0};
    double *R = at->R, *omega = at->omega, next[9], step[3];
    UNROLLED for (int k = 0; k < 9; k++) R[k] = unit[k];
    UNROLLED for (int k = 0; k < 3; k++) at->p[k] = at->dp[k] = omega[k] = 0.0;
    for (int i = 0; i < chain->n; i++) {
        JointInBase *here = &joint[i];
        rotate(R, pose[i].r, step);
        multiply(R, pose[i].R, next);
        add_cross(omega, step, at->dp);
        UNROLLED for (int k = 0; k < 9; k++) R[k] = next[k];
        UNROLLED for (int k = 0; k < 3; k++)
        {
            at->p[k] += step[k];
            here->axis[k] = R[3 * k + 2];
            if (is_prismatic(chain, i)) at->dp[k] += here->axis[k] * dq[i];
            here->origin[k] = at->p[k];
            here->velocity[k] = at->dp[k];
        }
        cross(omega, here->axis, here->axis_rate);
        if (is_prismatic(chain, i)) continue;
        UNROLLED for (int k = 0; k < 3; k++) omega[k] += here->axis[k] * dq[i];
    }
    rotate(R, tip, step);
    add_cross(omega, step, at->dp);
    UNROLLED for (int k = 0; k < 3; k++) at->p[k] += step[k];
}

/* All of Tip, of the point `tip` (3,) in the frame of the last link, at the velocity dq (n,). */
static inline void chain_tip(const Chain *chain, const Pose *pose, const double tip[3], const double *dq,
                             Tip *at)
{
    JointInBase joint[CHAIN_MOST];
    place_tip(chain, pose, tip, dq, joint, at);
    for (int i = 0; i < chain->n; i++) {
        const JointInBase *here = &joint[i];
        double arm[3], arm_rate[3], J[3], dJ[3];
        UNROLLED for (int k = 0; k < 3; k++)
        {
            arm[k] = at->p[k] - here->origin[k];
            arm_rate[k] = at->dp[k] - here->velocity[k];
        }
        cross(here->axis, arm, J);
        cross(here->axis_rate, arm, dJ);
        add_cross(here->axis, arm_rate, dJ);
        const int slides = is_prismatic(chain, i);
        UNROLLED for (int k = 0; k < 3; k++)
        {
            at->J[k][i] = slides ? here->axis[k] : J[k];
            at->dJ[k][i] = slides ? here->axis_rate[k] : dJ[k];
            at->J[k + 3][i] = slides ? 0.0 : here->axis[k];
            at->dJ[k + 3][i] = slides ? 0.0 : here->axis_rate[k];
        }
    }
}

#endif
