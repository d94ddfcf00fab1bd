/* tip_turn.h - the turn of the tip as three coordinates: twice the vector part of its quaternion.
 *
 *     C = F R R_0^T F^T,   C has the quaternion (eta, eps) with eta >= 0,   x = 2 eps
 *     dx = (eta - [eps]) omega,   deta = -eps . omega / 2,   deps = dx / 2
 *
 * in the common axes F; C is the turn from the orientation R_0 to R, by less than pi: the short way.
 */
#ifndef TIP_TURN_H
#define TIP_TURN_H

#include "chain_tip.h"
#include "contact.h"

/* x (3,), and B (3, 3) with dx = B omega, its angular velocity in the base, and the rate of B. */
typedef struct {
    double x[3], B[9], dB[9];
} Turn;

/* The quaternion of a rotation C (row-major) with eta >= 0, by its greatest entry. */
static inline void quaternion(const double C[9], double *eta, double eps[3])
{
    const double trace = C[0] + C[4] + C[8];
    const double odd[3] = {C[7] - C[5], C[2] - C[6], C[3] - C[1]}; /* 4 eta eps */
    if (trace > 0.0) {
        *eta = 0.5 * square_root(1.0 + trace);
        for (int k = 0; k < 3; k++) eps[k] = 0.25 * odd[k] / *eta;
        return;
    }
    const int m = C[0] >= C[4] && C[0] >= C[8] ? 0 : C[4] >= C[8] ? 1 : 2;
    const double own = 0.5 * square_root(1.0 + 2.0 * C[4 * m] - trace);
    const double sign = odd[m] < 0.0 ? -1.0 : 1.0;
    *eta = sign * 0.25 * odd[m] / own;
    for (int k = 0; k < 3; k++) eps[k] = sign * (k == m ? own : 0.25 * (C[3 * k + m] + C[3 * m + k]) / own);
}

/* E = a - [b], row-major. */
static inline void less_cross(double a, const double b[3], double E[9])
{
    E[0] = E[4] = E[8] = a;
    E[1] = b[2];
    E[2] = -b[1];
    E[3] = -b[2];
    E[5] = b[0];
    E[6] = b[1];
    E[7] = -b[0];
}

/* The turn of the tip `at`, in the axes F (3, 3), from the orientation R_0 (3, 3). */
static inline void turn_of(const Tip *at, const double F[9], const double R_0[9], Turn *turn)
{
    double FR[9], FR_0[9], C[9], E[9], eta, eps[3], deps[3], omega[3], deta = 0.0;
    multiply(F, at->R, FR);
    multiply(F, R_0, FR_0);
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            C[3 * i + k] =
                FR[3 * i] * FR_0[3 * k] + FR[3 * i + 1] * FR_0[3 * k + 1] + FR[3 * i + 2] * FR_0[3 * k + 2];
    quaternion(C, &eta, eps);
    rotate(F, at->omega, omega);
    less_cross(eta, eps, E);
    multiply(E, F, turn->B);
    rotate(E, omega, deps);
    for (int k = 0; k < 3; k++) {
        turn->x[k] = 2.0 * eps[k];
        deps[k] *= 0.5;
        deta -= 0.5 * eps[k] * omega[k];
    }
    less_cross(deta, deps, E);
    multiply(E, F, turn->dB);
}

#endif
