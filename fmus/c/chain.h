/* chain.h - dynamics of a serial chain of up to 16 joints, described by a table.
 *
 * Link i and its frame sit on joint i, which moves about (revolute) or along (prismatic) the z axis
 * of that frame. For an angle or a displacement q_i the link's pose in its parent's frame is
 *
 *     revolute     p_parent = R_i Rz(q_i) p + r_i
 *     prismatic    p_parent = R_i p + r_i + R_i e_z q_i
 *
 * A link has ten inertial parameters: m, m c (x y z), and I about the origin of its frame (xx xy yy
 * xz yz zz). Twists and wrenches are six numbers, angular part first, at the origin of a link's frame
 * and in its axes. Source: R. Featherstone, Rigid Body Dynamics Algorithms, Springer, 2008, chapters
 * 5 and 7. The variables of a model that describe its chain are those of fmus/arms/chain.py.
 */
#ifndef CHAIN_H
#define CHAIN_H

#include <stddef.h>

#include "declaration.h"
#include "trig.h"

enum { CHAIN_MOST = 16 };

/* A view of the table: n joints, row-major arrays; see fmus/arms/chain.py for shapes and units. */
typedef struct {
    int n;
    const Real *type, *rotation, *origin, *inertia, *armature, *g;
} Chain;

/* The chain of a model `x` that has the variables of the table; an initializer. */
#define CHAIN_OF(x)                 \
    {COUNT(x, ENTRIES(joint_type)), \
     (x)->joint_type,               \
     (x)->rotation[0][0],           \
     (x)->origin[0],                \
     (x)->inertia[0],               \
     (x)->armature,                 \
     (x)->g}

/* p_parent = R p + r; R row-major. */
typedef struct {
    Real R[9], r[3];
} Pose;

static inline int is_prismatic(const Chain *chain, int i) { return COMMON(chain->type[i]) != 0.0; }

/* The place of the joint's axis in a twist or wrench: about z, or along z. */
static inline int axis_of(const Chain *chain, int i) { return is_prismatic(chain, i) ? 5 : 2; }

/* ---- vectors of three numbers ---------------------------------------------------------------- */

static inline void cross(const Real a[3], const Real b[3], Real c[3])
{
    c[0] = a[1] * b[2] - a[2] * b[1];
    c[1] = a[2] * b[0] - a[0] * b[2];
    c[2] = a[0] * b[1] - a[1] * b[0];
}

/* c += a x b. */
static inline void add_cross(const Real a[3], const Real b[3], Real c[3])
{
    c[0] += a[1] * b[2] - a[2] * b[1];
    c[1] += a[2] * b[0] - a[0] * b[2];
    c[2] += a[0] * b[1] - a[1] * b[0];
}

/* b = R a. */
static inline void rotate(const Real R[9], const Real a[3], Real b[3])
{
    b[0] = R[0] * a[0] + R[1] * a[1] + R[2] * a[2];
    b[1] = R[3] * a[0] + R[4] * a[1] + R[5] * a[2];
    b[2] = R[6] * a[0] + R[7] * a[1] + R[8] * a[2];
}

/* b = R^T a. */
static inline void rotate_back(const Real R[9], const Real a[3], Real b[3])
{
    b[0] = R[0] * a[0] + R[3] * a[1] + R[6] * a[2];
    b[1] = R[1] * a[0] + R[4] * a[1] + R[7] * a[2];
    b[2] = R[2] * a[0] + R[5] * a[1] + R[8] * a[2];
}

/* ---- twists and wrenches --------------------------------------------------------------------- */

/* A twist of the parent, in the frame of the link. */
static inline void to_link(const Pose *pose, const Real parent[6], Real link[6])
{
    Real u[3] = {parent[3], parent[4], parent[5]};
    add_cross(parent, pose->r, u);
    rotate_back(pose->R, parent, link);
    rotate_back(pose->R, u, link + 3);
}

/* Adds a wrench on the link, given in its frame, to one on the parent. */
static inline void add_to_parent(const Pose *pose, const Real link[6], Real parent[6])
{
    Real n[3], f[3];
    rotate(pose->R, link, n);
    rotate(pose->R, link + 3, f);
    add_cross(pose->r, f, n);
    UNROLLED for (int k = 0; k < 3; k++)
    {
        parent[k] += n[k];
        parent[k + 3] += f[k];
    }
}

/* h = I v, the momentum of a link with the ten parameters theta and the twist v. */
static inline void momentum(const Real theta[10], const Real v[6], Real h[6])
{
    const Real m = theta[0], *mc = theta + 1, *I = theta + 4, *w = v, *u = v + 3;
    h[0] = I[0] * w[0] + I[1] * w[1] + I[3] * w[2];
    h[1] = I[1] * w[0] + I[2] * w[1] + I[4] * w[2];
    h[2] = I[3] * w[0] + I[4] * w[1] + I[5] * w[2];
    add_cross(mc, u, h);
    h[3] = m * u[0];
    h[4] = m * u[1];
    h[5] = m * u[2];
    add_cross(w, mc, h + 3);
}

/* f += v x* h, what the momentum h changes by in a frame that moves with the twist v. */
static inline void add_gyration(const Real v[6], const Real h[6], Real f[6])
{
    add_cross(v, h, f);
    add_cross(v + 3, h + 3, f);
    add_cross(v, h + 3, f + 3);
}

/* a += v x S rate, where S is the axis of joint i, and `rate` the joint's velocity. */
static inline void add_turning(const Chain *chain, int i, const Real v[6], Real rate, Real a[6])
{
    const Real x = v[1] * rate, y = -v[0] * rate;
    if (is_prismatic(chain, i)) {
        a[3] += x;
        a[4] += y;
        return;
    }
    a[0] += x;
    a[1] += y;
    a[3] += v[4] * rate;
    a[4] -= v[3] * rate;
}

/* ---- kinematics ------------------------------------------------------------------------------ */

/* The pose of each link in its parent's frame, at the position q (n,), rad or m. */
static inline void chain_pose(const Chain *chain, const Real *q, Pose *pose)
{
    for (int i = 0; i < chain->n; i++) {
        const Real *R = chain->rotation + 9 * i, *r = chain->origin + 3 * i;
        const Real along = is_prismatic(chain, i) ? q[i] : REAL(0.0);
        Real s = REAL(0.0), c = REAL(1.0);
        if (!is_prismatic(chain, i)) sine_cosine(q[i], &s, &c);
        UNROLLED for (int k = 0; k < 3; k++)
        {
            pose[i].R[3 * k] = R[3 * k] * c + R[3 * k + 1] * s;
            pose[i].R[3 * k + 1] = R[3 * k + 1] * c - R[3 * k] * s;
            pose[i].R[3 * k + 2] = R[3 * k + 2];
            pose[i].r[k] = r[k] + R[3 * k + 2] * along;
        }
    }
}

/* The acceleration of the base in free fall upwards, which is what gravity does to the links. */
static inline void base_acceleration(const Chain *chain, Real a[6])
{
    a[0] = a[1] = a[2] = REAL(0.0);
    UNROLLED for (int k = 0; k < 3; k++) a[k + 3] = -chain->g[k];
}

/* ---- dynamics: M(q) ddq + C(q, dq) dq + g(q) + armature ddq = tau ------------------------------ */

/* tau (n,), N.m or N, of the motion q, dq, ddq (n,): recursive Newton-Euler algorithm. */
static inline void chain_inverse(const Chain *chain, const Real *q, const Real *dq, const Real *ddq,
                                 Real *tau)
{
    const int n = chain->n;
    Pose pose[CHAIN_MOST];
    Real f[CHAIN_MOST][6], v[6] = {0}, a[6];
    chain_pose(chain, q, pose);
    base_acceleration(chain, a);
    for (int i = 0; i < n; i++) {
        const Real *theta = chain->inertia + 10 * i;
        const int axis = axis_of(chain, i);
        Real below[6], h[6];
        UNROLLED for (int k = 0; k < 6; k++) below[k] = v[k];
        to_link(&pose[i], below, v);
        v[axis] += dq[i];
        UNROLLED for (int k = 0; k < 6; k++) below[k] = a[k];
        to_link(&pose[i], below, a);
        a[axis] += ddq[i];
        add_turning(chain, i, v, dq[i], a);
        momentum(theta, a, f[i]);
        momentum(theta, v, h);
        add_gyration(v, h, f[i]);
    }
    for (int i = n - 1; i >= 0; i--) {
        tau[i] = f[i][axis_of(chain, i)] + chain->armature[i] * ddq[i];
        if (i > 0) add_to_parent(&pose[i], f[i], f[i - 1]);
    }
}

/* tau (n,) = g(q), the torques that hold the chain at rest: what is left of chain_inverse then. */
static inline void chain_gravity(const Chain *chain, const Pose *pose, Real *tau)
{
    const int n = chain->n;
    Real f[CHAIN_MOST][6], below[3], a[3];
    UNROLLED for (int k = 0; k < 3; k++) a[k] = -chain->g[k];
    for (int i = 0; i < n; i++) {
        const Real *theta = chain->inertia + 10 * i;
        UNROLLED for (int k = 0; k < 3; k++) below[k] = a[k];
        rotate_back(pose[i].R, below, a);
        cross(theta + 1, a, f[i]);
        UNROLLED for (int k = 0; k < 3; k++) f[i][3 + k] = theta[0] * a[k];
    }
    for (int i = n - 1; i >= 0; i--) {
        tau[i] = f[i][axis_of(chain, i)];
        if (i > 0) add_to_parent(&pose[i], f[i], f[i - 1]);
    }
}

#endif
