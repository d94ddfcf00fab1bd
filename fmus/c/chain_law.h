/* chain_law.h - the dynamics of a serial chain as adaptive laws need it: linear in the inertial
 * parameters of its links.
 *
 *     Y(q, dq, z, dz) theta = M(q) dz + C(q, dq) z + g(q),      Ys = Y^T s
 *
 * C is the matrix of Christoffel symbols, so that dM/dt - 2 C is skew-symmetric. C(q, dq) z is the
 * symmetric bilinear form of the quadratic C(q, dq) dq: each quadratic term of the Newton-Euler
 * recursion is replaced by half the sum of both mixed products. With v, w, a the twists of link i by
 * dq and by z and its acceleration by dz, the wrench is
 *
 *     force   f = m b + alpha x mc + (omega_v x (omega_w x mc) + omega_w x (omega_v x mc)) / 2
 *     moment  n = I alpha + mc x b + (omega_v x I omega_w + omega_w x I omega_v) / 2
 *     b = a + (omega_v x u_w + omega_w x u_v) / 2
 *
 * (omega, u: angular and linear part; alpha, a: those of the acceleration). Y^T s is the derivative of
 * sum_i sigma_i . (n_i, f_i) by the parameters, where sigma is the twist by s; Y is never formed. The
 * cost grows with the number of joints. Our own derivation from the recursion of chain.h.
 */
#ifndef CHAIN_LAW_H
#define CHAIN_LAW_H

#include "chain.h"

/* Motion of link i: its twists due to dq, z and s, and its acceleration due to dz with the symmetric
 * products. */
typedef struct {
    Real v[6], w[6], a[6], sigma[6];
} LinkMotion;

/* n and f of a link with the parameters theta, added to `wrench`. */
static inline void add_wrench(const Real theta[10], const LinkMotion *of, const Real b[3], Real wrench[6])
{
    const Real m = theta[0], *mc = theta + 1, *I = theta + 4, *alpha = of->a;
    const Real *ov = of->v, *ow = of->w;
    Real Iv[3], Iw[3], cv[3], cw[3], n[3] = {0}, f[3] = {0};
    const Real rows[3][3] = {{I[0], I[1], I[3]}, {I[1], I[2], I[4]}, {I[3], I[4], I[5]}};
    UNROLLED for (int k = 0; k < 3; k++)
    {
        Iv[k] = rows[k][0] * ov[0] + rows[k][1] * ov[1] + rows[k][2] * ov[2];
        Iw[k] = rows[k][0] * ow[0] + rows[k][1] * ow[1] + rows[k][2] * ow[2];
    }
    cross(ov, mc, cv);
    cross(ow, mc, cw);
    add_cross(ov, Iw, n);
    add_cross(ow, Iv, n);
    add_cross(ov, cw, f);
    add_cross(ow, cv, f);
    UNROLLED for (int k = 0; k < 3; k++)
    {
        n[k] = 0.5 * n[k] + rows[k][0] * alpha[0] + rows[k][1] * alpha[1] + rows[k][2] * alpha[2];
        f[k] = 0.5 * f[k] + m * b[k];
    }
    add_cross(mc, b, n);
    add_cross(alpha, mc, f);
    UNROLLED for (int k = 0; k < 3; k++)
    {
        wrench[k] += n[k];
        wrench[k + 3] += f[k];
    }
}

/* c += x (as a row) (I y), by the entries xx xy yy xz yz zz of I. */
static inline void add_moments(double scale, const Real x[3], const Real y[3], Real c[6])
{
    c[0] += scale * x[0] * y[0];
    c[1] += scale * (x[0] * y[1] + x[1] * y[0]);
    c[2] += scale * x[1] * y[1];
    c[3] += scale * (x[0] * y[2] + x[2] * y[0]);
    c[4] += scale * (x[1] * y[2] + x[2] * y[1]);
    c[5] += scale * x[2] * y[2];
}

/* The derivative of sigma . (n, f) by the ten parameters of the link. */
static inline void link_gradient(const LinkMotion *of, const Real b[3], Real gradient[10])
{
    const Real *sa = of->sigma, *sl = of->sigma + 3, *ov = of->v, *ow = of->w;
    Real lv[3], lw[3], av[3], aw[3], c[3] = {0}, half[3] = {0};
    cross(sl, ov, lv);
    cross(sl, ow, lw);
    cross(sa, ov, av);
    cross(sa, ow, aw);
    add_cross(lv, ow, half);
    add_cross(lw, ov, half);
    add_cross(sl, of->a, c);
    add_cross(b, sa, c);
    gradient[0] = sl[0] * b[0] + sl[1] * b[1] + sl[2] * b[2];
    UNROLLED for (int k = 0; k < 3; k++) gradient[1 + k] = c[k] + 0.5 * half[k];
    UNROLLED for (int k = 4; k < 10; k++) gradient[k] = REAL(0.0);
    add_moments(1.0, sa, of->a, gradient + 4);
    add_moments(0.5, av, ow, gradient + 4);
    add_moments(0.5, aw, ov, gradient + 4);
}

/* Twists and acceleration of link i from those of the link `below` it, and b of its wrench. */
static inline void link_motion(const Chain *chain, const Pose *pose, int i, const LinkMotion *below,
                               const Real *dq, const Real *z, const Real *dz, LinkMotion *here, Real b[3])
{
    const int axis = axis_of(chain, i);
    Real turned[6] = {0};
    to_link(&pose[i], below->v, here->v);
    to_link(&pose[i], below->w, here->w);
    to_link(&pose[i], below->a, here->a);
    here->v[axis] += dq[i];
    here->w[axis] += z[i];
    add_turning(chain, i, here->v, 0.5 * z[i], turned);
    add_turning(chain, i, here->w, 0.5 * dq[i], turned);
    here->a[axis] += dz[i];
    UNROLLED for (int k = 0; k < 6; k++) here->a[k] += turned[k];
    UNROLLED for (int k = 0; k < 3; k++) b[k] = REAL(0.0);
    add_cross(here->v, here->w + 3, b);
    add_cross(here->w, here->v + 3, b);
    UNROLLED for (int k = 0; k < 3; k++) b[k] = here->a[3 + k] + 0.5 * b[k];
}

/* tau (n,) = Y theta and Ys (n, 10) = Y^T s, for the estimate `theta` (n, 10) instead of the
 * table's inertia, in the position of `pose`. `base` (6,) is the acceleration of the base:
 * base_acceleration() for Y with gravity, 0 for Y without. The armature of the joints is no part of
 * either.
 */
static inline void chain_law(const Chain *chain, const Pose *pose, const Real *theta, const Real base[6],
                             const Real *dq, const Real *z, const Real *dz, const Real *s, Real *tau,
                             Real *Ys)
{
    static const Real still[6] = {0};
    const int n = chain->n;
    Real f[CHAIN_MOST][6];
    LinkMotion below, here;
    UNROLLED for (int k = 0; k < 6; k++)
    {
        below.v[k] = below.w[k] = below.sigma[k] = still[k];
        below.a[k] = base[k];
    }
    for (int i = 0; i < n; i++) {
        Real b[3];
        link_motion(chain, pose, i, &below, dq, z, dz, &here, b);
        to_link(&pose[i], below.sigma, here.sigma);
        here.sigma[axis_of(chain, i)] += s[i];
        UNROLLED for (int k = 0; k < 6; k++) f[i][k] = REAL(0.0);
        add_wrench(theta + 10 * i, &here, b, f[i]);
        link_gradient(&here, b, Ys + 10 * i);
        below = here;
    }
    for (int i = n - 1; i >= 0; i--) {
        tau[i] = f[i][axis_of(chain, i)];
        if (i > 0) add_to_parent(&pose[i], f[i], f[i - 1]);
    }
}

/* How a law treats g(q): the values of its parameter `gravity`. */
enum { NO_GRAVITY, COMPENSATED, ADAPTED };

/* tau (n,): Y theta with the rotors' inertia, and g(q) of the table where it is compensated; and
 * Ys (n, 10) = Y^T s. Y contains gravity where it is adapted.
 */
static inline void chain_feedforward(const Chain *chain, const Pose *pose, int gravity, const Real *theta,
                                     const Real *dq, const Real *z, const Real *dz, const Real *s, Real *tau,
                                     Real *Ys)
{
    Real base[6] = {0}, g[CHAIN_MOST];
    if (gravity == ADAPTED) base_acceleration(chain, base);
    chain_law(chain, pose, theta, base, dq, z, dz, s, tau, Ys);
    if (gravity == COMPENSATED) {
        chain_gravity(chain, pose, g);
        for (int i = 0; i < chain->n; i++) tau[i] += g[i];
    }
    for (int i = 0; i < chain->n; i++) tau[i] += chain->armature[i] * dz[i];
}

#endif
