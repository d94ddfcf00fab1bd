/* guard.h: limits of a torque between controller and codec.
 *
 * Deterministic: its inputs are recorded, so a replay takes the same decisions. docs/safety.md describes
 * every rule and how to reset it. */
#ifndef BRIDGE_GUARD_H
#define BRIDGE_GUARD_H

#include <stdint.h>

#include "frame.h"

enum { SAFETY_JOINTS = 32 }; /* the most joints a guard or a drive can have */

enum guard_bit {
    GUARD_FINITE = 1 << 0,
    GUARD_TORQUE = 1 << 1,
    GUARD_RATE = 1 << 2,
    GUARD_POSITION = 1 << 3,
    GUARD_VELOCITY = 1 << 4,
    GUARD_POWER = 1 << 5,
    GUARD_JUMP = 1 << 6
};

typedef struct {
    int32_t joints;
    uint32_t stops;               /* GUARD_ bits that are not only limited but stop the node */
    const double *tau_max;        /* N.m, a joint; NULL: no limit; so below */
    const double *rate_max;       /* N.m/s */
    const double *q_low, *q_high; /* rad: beyond, torque outwards is taken away, and braking added */
    const double *dq_max;         /* rad/s: beyond, torque that accelerates is taken away */
    const double *power_max;      /* W, of tau dq, a joint; braking (tau dq < 0) is not limited */
    const double *q_jump;         /* rad a tick an encoder may move; more is a fault of the encoder */
    double brake;                 /* N.m.s/rad, damping beyond a soft limit, while moving outwards */
    double h;                     /* s */
    double *last_tau, *last_q;    /* state; last_q NaN: none yet */
    int64_t trips[8];             /* ticks in which each bit was set */
    uint32_t bits;                /* of the last tick */
    uint32_t reserved;
} guard_t;

/* Limits the torque tau (joints,) of the controller and writes it to out (joints,). Returns the GUARD_ bits.
 * If q or dq is NULL, the checks that need it are skipped.
 *
 * In this order, for each joint: finite (tau, q, dq; else 0), encoder jump (else 0), tau_max,
 * rate_max, q_low..q_high, dq_max, power_max, brake, tau_max again, and last `scale` of the life
 * cycle. A limit takes effect immediately; after it, the torque returns at rate_max. The rate is that of
 * the torque before `scale`: a ramp down is not rate limited, the controller behind it is; after
 * scale = 0 the torque starts from 0. `out` is finite and within tau_max for any input. */
API uint32_t guard_apply(guard_t *g, const double *tau, const double *q, const double *dq, double scale,
                         double *out);
/* The next position is compared with none before: there was none of now for a while. */
API void guard_forget(guard_t *g);
/* WHY_ bits that the last tick's GUARD_ bits raise: those in `stops`. */
API uint32_t guard_why(const guard_t *g);

#endif
