/* chain_check.h - whether the table of an arm is physically possible; messages name the link. */
#ifndef CHAIN_CHECK_H
#define CHAIN_CHECK_H

#include "chain.h"

#if TOGETHER == 1

/* One message per link: a kernel has no memory to compose a message in. */
#define OF_EACH_LINK(text)                                                   \
    {"link 0: " text,  "link 1: " text,  "link 2: " text,  "link 3: " text,  \
     "link 4: " text,  "link 5: " text,  "link 6: " text,  "link 7: " text,  \
     "link 8: " text,  "link 9: " text,  "link 10: " text, "link 11: " text, \
     "link 12: " text, "link 13: " text, "link 14: " text, "link 15: " text}

static inline double determinant(double a, double b, double c, double d) { return a * d - b * c; }

/* Whether R (row-major) is a rotation, to 1e-6. */
static inline int is_rotation(const double R[9])
{
    int good = 1;
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) {
            const double *a = R + 3 * i, *b = R + 3 * k;
            const double d = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] - (i == k ? 1.0 : 0.0);
            good &= d < 1e-6 && d > -1e-6;
        }
    double c[3];
    cross(R, R + 3, c);
    return good && c[0] * R[6] + c[1] * R[7] + c[2] * R[8] > 0.0;
}

/* Whether a body has the ten parameters: m > 0, and Sigma = tr(I) / 2 - I about the centre of mass
 * positive semidefinite, which is the triangle inequality of the principal moments; or all are 0.
 * All principal minors of Sigma, divided by its trace, may miss 0 by the rounding of a table.
 */
static inline int is_body(const double theta[10])
{
    const double m = theta[0], *mc = theta + 1, *I = theta + 4, rounding = -1e-9;
    int empty = 1;
    for (int k = 1; k < 10; k++) empty &= theta[k] == 0.0;
    if (!(m > 0.0)) return m == 0.0 && empty;
    const double half = 0.5 * (I[0] + I[2] + I[5]);
    if (half == 0.0) return empty;
    const double xx = (half - I[0] - mc[0] * mc[0] / m) / half;
    const double yy = (half - I[2] - mc[1] * mc[1] / m) / half;
    const double zz = (half - I[5] - mc[2] * mc[2] / m) / half;
    const double xy = (-I[1] - mc[0] * mc[1] / m) / half;
    const double xz = (-I[3] - mc[0] * mc[2] / m) / half;
    const double yz = (-I[4] - mc[1] * mc[2] / m) / half;
    const double minors = xx * determinant(yy, yz, yz, zz) - xy * determinant(xy, yz, xz, zz) +
                          xz * determinant(xy, yy, xz, yz);
    return half > 0.0 && xx >= rounding && yy >= rounding && zz >= rounding &&
           determinant(xx, xy, xy, yy) >= rounding && determinant(xx, xz, xz, zz) >= rounding &&
           determinant(yy, yz, yz, zz) >= rounding && minors >= rounding;
}

/* NULL, or a message that names the first link of the table that is physically impossible. */
static inline const char *chain_problem(const Chain *chain)
{
    static const char *const no_rotation[CHAIN_MOST] = OF_EACH_LINK("`rotation` is not a rotation matrix");
    static const char *const no_body[CHAIN_MOST] =
        OF_EACH_LINK("no body has this `inertia`: mass >= 0, and no principal moment about the"
                     " centre of mass negative or greater than the sum of the other two");
    for (int i = 0; i < chain->n; i++) {
        if (chain->type[i] != 0.0 && chain->type[i] != 1.0) return "joint_type must be 0 or 1";
        if (!is_rotation(chain->rotation + 9 * i)) return no_rotation[i];
        if (!is_body(chain->inertia + 10 * i)) return no_body[i];
    }
    return NULL;
}

#endif
#endif
