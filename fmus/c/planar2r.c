/* planar2r.c - planar arm with two revolute joints; equations in fmus/models/planar2r.py.
 *
 * Integrated with the Runge-Kutta method of order 4, `substeps` steps per communication step. The torques
 * of hand and wall are evaluated at every stage. Arms of one kind are stepped LANES at a time.
 */
#include <stddef.h>

#include "environment.h"
#include "lanes.h"
#include "model.h"
#include "trig.h"

static inline int is_level(const Model *x) {
    return x->theta_g[0] == 0.0 && x->theta_g[1] == 0.0;
}

#define REAL double
#define ARM Model
#define TEMPLATE(name) name
#define TEMPLATE_INLINE static inline
#include "planar2r_motion.h"
#undef REAL
#undef ARM
#undef TEMPLATE
#undef TEMPLATE_INLINE

const char *model_initial(Model *x) {
    const double *theta = x->theta;
    if (!(theta[2] > 0.0 && theta[0] * theta[2] - theta[2] * theta[2] - theta[1] * theta[1] > 0.0))
        return "theta gives no positive definite inertia: theta[2] > 0 and theta[0] theta[2]"
               " - theta[2]^2 - theta[1]^2 > 0 are needed";
    if (environment_problem(x)) return environment_problem(x);
    return arrive(x, x->q, x->dq);
}

#ifdef EXCHANGE
const char *model_rates(Model *x) {
    const double torque[2] = {x->tau[0] + x->tau_ext[0], x->tau[1] + x->tau_ext[1]};
    acceleration(x, torque, x->q, x->dq, x->ddq);
    return all_finite(x->ddq, 2) ? arrive(x, x->q, x->dq) : DIVERGED;
}
#endif

const char *model_step(Model *x, double t, double h) {
    const int substeps = (int)x->substeps;
    const double torque[2] = {x->tau[0] + x->tau_ext[0], x->tau[1] + x->tau_ext[1]};
    double q[2] = {x->q[0], x->q[1]}, dq[2] = {x->dq[0], x->dq[1]};
    (void)t; /* the arm does not depend on time */
    for (int i = 0; i < substeps; i++) runge_kutta(x, torque, h / substeps, q, dq);
    return arrive(x, q, dq);
}

#if HAS_LANES
#include "trig_lanes.h"

/* The parameters of LANES arms with walls of spring and damper. */
typedef struct {
    Lanes theta[3], theta_g[2];
    Lanes grip, k_d[2], k_p[2], q_h[2], q_w[2], k_w[2], b_w[2];
    int level;
} Arms;

LANES_INLINE int is_level_lanes(const Arms *x) { return x->level; }

LANES_INLINE Lanes hand_lanes(const Arms *x, int i, Lanes q, Lanes dq) {
    return GRIP(x->grip, x->k_d[i], x->k_p[i], x->q_h[i], q, dq);
}

LANES_INLINE Lanes wall_lanes(const Arms *x, int i, Lanes q, Lanes dq) {
    const Lanes none = {0.0}, depth = q - x->q_w[i];
    const Lanes torque = SPRING_AND_DAMPER(depth, dq, x->k_w[i], x->b_w[i]);
    return pick((depth > 0.0) & (torque > 0.0), torque, none);
}

#define REAL Lanes
#define ARM Arms
#define TEMPLATE(name) name##_lanes
#define TEMPLATE_INLINE LANES_INLINE
#include "planar2r_motion.h"

LANES_INLINE int all_finite_lanes(const Lanes x[], int n) {
    Mask finite = {-1, -1, -1, -1};
    for (int i = 0; i < n; i++) finite &= x[i] - x[i] == 0.0;
    return finite[0] & finite[1] & finite[2] & finite[3] & 1;
}

/* `arrive` for LANES arms. */
LANES_INLINE void arrive_lanes(Model *const x[], const Arms *arms, const Lanes q[2],
                               const Lanes dq[2], const char *why[]) {
    Lanes tau_h[2], tau_e[2];
    for (int i = 0; i < 2; i++) {
        tau_h[i] = hand_lanes(arms, i, q[i], dq[i]);
        tau_e[i] = wall_lanes(arms, i, q[i], dq[i]);
    }
    if (!(all_finite_lanes(q, 2) && all_finite_lanes(dq, 2) && all_finite_lanes(tau_h, 2) &&
          all_finite_lanes(tau_e, 2))) {
        for (int k = 0; k < LANES; k++) {
            const double at[2] = {q[0][k], q[1][k]}, moves[2] = {dq[0][k], dq[1][k]};
            why[k] = arrive(x[k], at, moves);
        }
        return;
    }
    for (int k = 0; k < LANES; k++) {
        for (int i = 0; i < 2; i++) {
            x[k]->q[i] = q[i][k];
            x[k]->dq[i] = dq[i][k];
            x[k]->tau_h[i] = tau_h[i][k];
            x[k]->tau_e[i] = tau_e[i][k];
        }
        why[k] = NULL;
    }
}

/* LANES arms of one kind. */
LANES_INLINE void step_arms(Model *const x[], double h, const char *why[]) {
    const int substeps = (int)x[0]->substeps;
    Lanes torque[2], q[2], dq[2];
    Arms arms;
    arms.level = is_level(x[0]);
    for (int k = 0; k < LANES; k++) {
        const Model *one = x[k];
        arms.grip[k] = one->grip;
        for (int i = 0; i < 3; i++) arms.theta[i][k] = one->theta[i];
        for (int i = 0; i < 2; i++) {
            arms.theta_g[i][k] = one->theta_g[i];
            arms.k_d[i][k] = one->k_d[i], arms.k_p[i][k] = one->k_p[i];
            arms.q_h[i][k] = one->q_h[i], arms.q_w[i][k] = one->q_w[i];
            arms.k_w[i][k] = one->k_w[i], arms.b_w[i][k] = one->b_w[i];
            torque[i][k] = one->tau[i] + one->tau_ext[i];
            q[i][k] = one->q[i], dq[i][k] = one->dq[i];
        }
    }
    for (int i = 0; i < substeps; i++) runge_kutta_lanes(&arms, torque, h / substeps, q, dq);
    arrive_lanes(x, &arms, q, dq, why);
}

/* Whether they differ in numbers only. */
static int are_alike(Model *const x[]) {
    for (int k = 0; k < LANES; k++)
        if ((int)x[k]->contact != SPRING_DAMPER || x[k]->substeps != x[0]->substeps ||
            is_level(x[k]) != is_level(x[0]))
            return 0;
    return 1;
}

#if HAS_AVX2
WITH_AVX2 static void step_arms_avx2(Model *const x[], double h, const char *why[]) {
    step_arms(x, h, why);
}
#endif
#endif

void model_steps(Model *const x[], double t, double h, const char *why[]) {
#if HAS_LANES
    if (are_alike(x)) {
#if HAS_AVX2
        if (CAN_AVX2) {
            step_arms_avx2(x, h, why);
            return;
        }
#endif
        step_arms(x, h, why);
        return;
    }
#endif
    for (int k = 0; k < LANES; k++) why[k] = model_step(x[k], t, h);
}
