/* commands.h - the commands of a law for a robot that takes velocities or positions, for a model with
 * z, z_next, q_next, q_c, dq_c, v_max and clamped.
 */
#ifndef COMMANDS_H
#define COMMANDS_H

#include "limit.h"
#include "model.h"

/* Joint i at rest where the arm is, with the z that is set. */
static inline void begin_command(Model *x, int i)
{
    x->z[i] = x->z_next[i] = x->dq_c[i] = limited(x->z[i], x->v_max[i]);
    x->q_c[i] = x->q_next[i] = x->q[i];
}

/* The command dq_c of joint i, and its state h later. Where the servo is limited, z changes in the
 * other direction only, and q_c follows the arm. */
static inline void give_command(Model *x, int i, double dq_c, double dz, double h)
{
    const double allowed = limited(dq_c, x->v_max[i]), clamped = x->clamped[i];
    const double moved = clamped * (allowed - x->dq[i]) > 0.0 ? x->dq[i] : allowed;
    const double change = clamped * dz > 0.0 ? 0.0 : dz;
    x->dq_c[i] = allowed;
    x->q_c[i] = x->q_next[i] = x->q_next[i] + h * moved;
    x->z_next[i] = limited(x->z[i] + h * change, x->v_max[i]);
}

#endif
