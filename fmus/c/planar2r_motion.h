/* planar2r_motion.h - a template, see lanes.h: the motion of the planar arm over a step.
 *
 *     M(q) ddq + C(q, dq) dq + g(q) = tau + tau_ext + tau_h - tau_e
 *
 * ARM: the type of the parameters; TEMPLATE(hand), TEMPLATE(wall), TEMPLATE(sine_cosine) and
 * TEMPLATE(is_level) are given.
 */

/* g(q) = (theta_g1 cos q1 + theta_g2 cos (q1 + q2), theta_g2 cos (q1 + q2)), N.m. */
TEMPLATE_INLINE void TEMPLATE(gravity)(const REAL theta_g[2], const REAL q[2], REAL g[2]) {
    REAL s1, c1, s12, c12;
    TEMPLATE(sine_cosine)(q[0], &s1, &c1);
    TEMPLATE(sine_cosine)(q[0] + q[1], &s12, &c12);
    g[1] = theta_g[1] * c12;
    g[0] = theta_g[0] * c1 + g[1];
}

/* ddq = M^-1 (tau + tau_ext + tau_h - tau_e - C dq - g), rad/s^2; `torque` = tau + tau_ext. */
TEMPLATE_INLINE void TEMPLATE(acceleration)(const ARM *x, const REAL torque[2], const REAL q[2],
                                          const REAL dq[2], REAL ddq[2]) {
    const REAL *theta = x->theta;
    REAL s2, c2;
    TEMPLATE(sine_cosine)(q[1], &s2, &c2);
    const REAL M11 = theta[0] + 2.0 * theta[1] * c2;
    const REAL M12 = theta[2] + theta[1] * c2;
    const REAL M22 = theta[2];
    const REAL h = theta[1] * s2;
    const REAL Cdq1 = -h * dq[1] * (2.0 * dq[0] + dq[1]);
    const REAL Cdq2 = h * dq[0] * dq[0];
    REAL b1 = torque[0] + TEMPLATE(hand)(x, 0, q[0], dq[0]) - TEMPLATE(wall)(x, 0, q[0], dq[0]) -
              Cdq1;
    REAL b2 = torque[1] + TEMPLATE(hand)(x, 1, q[1], dq[1]) - TEMPLATE(wall)(x, 1, q[1], dq[1]) -
              Cdq2;
    if (!TEMPLATE(is_level)(x)) {
        REAL g[2];
        TEMPLATE(gravity)(x->theta_g, q, g);
        b1 -= g[0];
        b2 -= g[1];
    }
    const REAL inverse = 1.0 / (M11 * M22 - M12 * M12);
    ddq[0] = (M22 * b1 - M12 * b2) * inverse;
    ddq[1] = (M11 * b2 - M12 * b1) * inverse;
}

/* One step h of the classical method, in place. */
TEMPLATE_INLINE void TEMPLATE(runge_kutta)(const ARM *x, const REAL torque[2], double h, REAL q[2],
                                         REAL dq[2]) {
    REAL k1[2], k2[2], k3[2], k4[2]; /* ddq of the stages; their dq is v1 = dq, v2, v3, v4 */
    REAL p[2], v2[2], v3[2], v4[2];
    TEMPLATE(acceleration)(x, torque, q, dq, k1);
    for (int i = 0; i < 2; i++) {
        p[i] = q[i] + 0.5 * h * dq[i];
        v2[i] = dq[i] + 0.5 * h * k1[i];
    }
    TEMPLATE(acceleration)(x, torque, p, v2, k2);
    for (int i = 0; i < 2; i++) {
        p[i] = q[i] + 0.5 * h * v2[i];
        v3[i] = dq[i] + 0.5 * h * k2[i];
    }
    TEMPLATE(acceleration)(x, torque, p, v3, k3);
    for (int i = 0; i < 2; i++) {
        p[i] = q[i] + h * v3[i];
        v4[i] = dq[i] + h * k3[i];
    }
    TEMPLATE(acceleration)(x, torque, p, v4, k4);
    for (int i = 0; i < 2; i++) {
        q[i] += h / 6.0 * (dq[i] + 2.0 * (v2[i] + v3[i]) + v4[i]);
        dq[i] += h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]);
    }
}
