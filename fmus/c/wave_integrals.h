/* wave_integrals.h - waves over a line that sends their integrals; equations in
 * fmus/models/wave_integral_impedance.py.
 */
#ifndef WAVE_INTEGRALS_H
#define WAVE_INTEGRALS_H

#include <math.h>

/* The part of the received integrals that was given on: N.m.s and J. */
typedef struct {
    double U, E;
} WaveGiven;

/* The wave of the next step of h (s), N.m, from the received integrals U_j, E_j; `given` follows. */
static inline double wave_given(double U_j, double E_j, double b, double h, WaveGiven *given)
{
    const double left = U_j - given->U, energy = 4.0 * b * (E_j - given->E);
    if (!(h > 0.0) || !(energy > 0.0)) return 0.0;
    const double wave = left != 0.0 ? energy / left : 0.0;
    if (fabs(wave) * h < fabs(left)) {
        given->U += h * wave;
        given->E += h * wave * wave / (4.0 * b);
        return wave;
    }
    given->U = U_j; /* all of it; the energy that this does not need is dissipated */
    given->E = E_j;
    return left / h;
}

#endif
