/* chain_forward.h - the acceleration of a serial chain: Featherstone's articulated-body algorithm.
 *
 * From the last link to the first, each joint is eliminated from the inertia of the links after it:
 * the cost grows with the number of joints, not with its square or cube. Source and notation: chain.h.
 */
#ifndef CHAIN_FORWARD_H
#define CHAIN_FORWARD_H

#include "chain.h"

/* The inertia that a link and all links after it show at the link's frame, joints free:
 *
 *     wrench = [ A  B; B^T  M ] acceleration,  A and M as xx xy xz yy yz zz, B row-major
 */
typedef struct {
    Real A[6], B[9], M[6];
} Articulated;

static inline Articulated articulated(const Real theta[10])
{
    const Real m = theta[0], *mc = theta + 1, *I = theta + 4, none = REAL(0.0);
    const Articulated of = {{I[0], I[1], I[3], I[2], I[4], I[5]},
                            {none, -mc[2], mc[1], mc[2], none, -mc[0], -mc[1], mc[0], none},
                            {m, none, none, m, none, m}};
    return of;
}

/* f += inertia a. */
static inline void add_product(const Articulated *of, const Real a[6], Real f[6])
{
    const Real *A = of->A, *B = of->B, *M = of->M, *w = a, *u = a + 3;
    f[0] += A[0] * w[0] + A[1] * w[1] + A[2] * w[2] + B[0] * u[0] + B[1] * u[1] + B[2] * u[2];
    f[1] += A[1] * w[0] + A[3] * w[1] + A[4] * w[2] + B[3] * u[0] + B[4] * u[1] + B[5] * u[2];
    f[2] += A[2] * w[0] + A[4] * w[1] + A[5] * w[2] + B[6] * u[0] + B[7] * u[1] + B[8] * u[2];
    f[3] += B[0] * w[0] + B[3] * w[1] + B[6] * w[2] + M[0] * u[0] + M[1] * u[1] + M[2] * u[2];
    f[4] += B[1] * w[0] + B[4] * w[1] + B[7] * w[2] + M[1] * u[0] + M[3] * u[1] + M[4] * u[2];
    f[5] += B[2] * w[0] + B[5] * w[1] + B[8] * w[2] + M[2] * u[0] + M[4] * u[1] + M[5] * u[2];
}

/* U = inertia S, for the axis S of the joint: a column. */
static inline void column(const Articulated *of, int axis, Real U[6])
{
    const Real *A = of->A, *B = of->B, *M = of->M;
    const Real about[6] = {A[2], A[4], A[5], B[6], B[7], B[8]};
    const Real along[6] = {B[2], B[5], B[8], M[2], M[4], M[5]};
    UNROLLED for (int k = 0; k < 6; k++) U[k] = axis == 2 ? about[k] : along[k];
}

/* inertia -= U U^T / D. */
static inline void subtract_square(Articulated *of, const Real U[6], Real inverse_D)
{
    Real s[6];
    UNROLLED for (int k = 0; k < 6; k++) s[k] = U[k] * inverse_D;
    Real *A = of->A, *B = of->B, *M = of->M;
    A[0] -= U[0] * s[0];
    A[1] -= U[0] * s[1];
    A[2] -= U[0] * s[2];
    A[3] -= U[1] * s[1];
    A[4] -= U[1] * s[2];
    A[5] -= U[2] * s[2];
    UNROLLED for (int k = 0; k < 3; k++)
    {
        B[3 * k] -= U[k] * s[3];
        B[3 * k + 1] -= U[k] * s[4];
        B[3 * k + 2] -= U[k] * s[5];
    }
    M[0] -= U[3] * s[3];
    M[1] -= U[3] * s[4];
    M[2] -= U[3] * s[5];
    M[3] -= U[4] * s[4];
    M[4] -= U[4] * s[5];
    M[5] -= U[5] * s[5];
}

/* T = R S R^T for a symmetric S, both as xx xy xz yy yz zz. */
static inline void turn_symmetric(const Real R[9], const Real S[6], Real T[6])
{
    Real P[9]; /* R S */
    UNROLLED for (int k = 0; k < 3; k++)
    {
        const Real *row = R + 3 * k;
        P[3 * k] = row[0] * S[0] + row[1] * S[1] + row[2] * S[2];
        P[3 * k + 1] = row[0] * S[1] + row[1] * S[3] + row[2] * S[4];
        P[3 * k + 2] = row[0] * S[2] + row[1] * S[4] + row[2] * S[5];
    }
    T[0] = P[0] * R[0] + P[1] * R[1] + P[2] * R[2];
    T[1] = P[0] * R[3] + P[1] * R[4] + P[2] * R[5];
    T[2] = P[0] * R[6] + P[1] * R[7] + P[2] * R[8];
    T[3] = P[3] * R[3] + P[4] * R[4] + P[5] * R[5];
    T[4] = P[3] * R[6] + P[4] * R[7] + P[5] * R[8];
    T[5] = P[6] * R[6] + P[7] * R[7] + P[8] * R[8];
}

/* T = R B R^T. */
static inline void turn(const Real R[9], const Real B[9], Real T[9])
{
    Real P[9]; /* R B */
    UNROLLED for (int k = 0; k < 3; k++)
    {
        const Real *row = R + 3 * k;
        P[3 * k] = row[0] * B[0] + row[1] * B[3] + row[2] * B[6];
        P[3 * k + 1] = row[0] * B[1] + row[1] * B[4] + row[2] * B[7];
        P[3 * k + 2] = row[0] * B[2] + row[1] * B[5] + row[2] * B[8];
    }
    UNROLLED for (int k = 0; k < 3; k++) rotate(R, P + 3 * k, T + 3 * k);
}

/* Adds the inertia of a link, in its frame, to that of the parent.
 *
 * Turned by R it is [A B; B^T M]; at a distance r, [A - B [r] + [r] B_p^T, B_p; ., M] with
 * B_p = B + [r] M, where [r] a = r x a.
 */
static inline void add_inertia(const Pose *pose, const Articulated *link, Articulated *parent)
{
    const Real *R = pose->R, *r = pose->r;
    Real A[6], B[9], M[6], G[9]; /* G = B_p */
    turn_symmetric(R, link->A, A);
    turn(R, link->B, B);
    turn_symmetric(R, link->M, M);
    const Real columns[3][3] = {{M[0], M[1], M[2]}, {M[1], M[3], M[4]}, {M[2], M[4], M[5]}};
    UNROLLED for (int k = 0; k < 3; k++)
    {
        const Real *m = columns[k];
        G[k] = B[k] + r[1] * m[2] - r[2] * m[1];
        G[3 + k] = B[3 + k] + r[2] * m[0] - r[0] * m[2];
        G[6 + k] = B[6 + k] + r[0] * m[1] - r[1] * m[0];
    }
    /* -B [r] has the rows r x (row of B); [r] G^T has the columns r x (row of G). */
    A[0] += r[1] * B[2] - r[2] * B[1] + r[1] * G[2] - r[2] * G[1];
    A[1] += r[2] * B[0] - r[0] * B[2] + r[1] * G[5] - r[2] * G[4];
    A[2] += r[0] * B[1] - r[1] * B[0] + r[1] * G[8] - r[2] * G[7];
    A[3] += r[2] * B[3] - r[0] * B[5] + r[2] * G[3] - r[0] * G[5];
    A[4] += r[0] * B[4] - r[1] * B[3] + r[2] * G[6] - r[0] * G[8];
    A[5] += r[0] * B[7] - r[1] * B[6] + r[0] * G[7] - r[1] * G[6];
    UNROLLED for (int k = 0; k < 6; k++) parent->A[k] += A[k];
    UNROLLED for (int k = 0; k < 9; k++) parent->B[k] += G[k];
    UNROLLED for (int k = 0; k < 6; k++) parent->M[k] += M[k];
}

/* Quantities of a joint that a later pass of the algorithm needs. */
typedef struct {
    Articulated inertia;
    Real v[6], c[6], p[6]; /* twist; acceleration by rotation; wrench of the links after it */
    Real U[6], inverse_D, u;
} Eliminated;

/* First pass, outwards: twists, and the wrenches of gyration. */
static inline void move_links(const Chain *chain, const Pose *pose, const Real *dq, Eliminated *link)
{
    static const Real still[6] = {0};
    for (int i = 0; i < chain->n; i++) {
        const Real *theta = chain->inertia + 10 * i;
        Eliminated *here = &link[i];
        Real h[6];
        to_link(&pose[i], i > 0 ? link[i - 1].v : still, here->v);
        here->v[axis_of(chain, i)] += dq[i];
        UNROLLED for (int k = 0; k < 6; k++) here->c[k] = here->p[k] = REAL(0.0);
        add_turning(chain, i, here->v, dq[i], here->c);
        momentum(theta, here->v, h);
        add_gyration(here->v, h, here->p);
        here->inertia = articulated(theta);
    }
}

/* Second pass, inwards: what remains of link i once its joint is free goes to its parent. */
static inline Truth eliminate(const Chain *chain, const Pose *pose, const Real *tau, Eliminated *link)
{
    Truth positive = ALWAYS;
    for (int i = chain->n - 1; i >= 0; i--) {
        const int axis = axis_of(chain, i);
        Eliminated *here = &link[i];
        column(&here->inertia, axis, here->U);
        const Real D = here->U[axis] + chain->armature[i];
        positive &= D > 0.0;
        here->inverse_D = 1.0 / D;
        here->u = tau[i] - here->p[axis];
        if (i == 0) break;
        subtract_square(&here->inertia, here->U, here->inverse_D);
        add_product(&here->inertia, here->c, here->p);
        const Real factor = here->u * here->inverse_D;
        UNROLLED for (int k = 0; k < 6; k++) here->p[k] += here->U[k] * factor;
        add_inertia(&pose[i], &here->inertia, &link[i - 1].inertia);
        add_to_parent(&pose[i], here->p, link[i - 1].p);
    }
    return positive;
}

/* ddq (n,), rad/s2 or m/s2, of the torques tau (n,) at q, dq (n,).
 *
 * Returns whether every joint has a positive inertia; if not, ddq means nothing.
 */
static inline Truth chain_forward(const Chain *chain, const Real *q, const Real *dq, const Real *tau,
                                  Real *ddq)
{
    Pose pose[CHAIN_MOST];
    Eliminated link[CHAIN_MOST];
    Real a[6];
    chain_pose(chain, q, pose);
    move_links(chain, pose, dq, link);
    const Truth positive = eliminate(chain, pose, tau, link);
    base_acceleration(chain, a);
    for (int i = 0; i < chain->n; i++) {
        const Eliminated *here = &link[i];
        Real parent[6], projected = REAL(0.0);
        UNROLLED for (int k = 0; k < 6; k++) parent[k] = a[k];
        to_link(&pose[i], parent, a);
        UNROLLED for (int k = 0; k < 6; k++)
        {
            a[k] += here->c[k];
            projected += here->U[k] * a[k];
        }
        ddq[i] = (here->u - projected) * here->inverse_D;
        a[axis_of(chain, i)] += ddq[i];
    }
    return positive;
}

#endif
