/* safety.h: what stands between a controller and a motor. Deterministic: its inputs are recorded,
 * so a replay takes the same decisions.
 */
#ifndef BRIDGE_SAFETY_H
#define BRIDGE_SAFETY_H

#include <stdint.h>

#include "frame.h"

/* ---- life cycle: of a node ---- */

enum { LIFE_UNCONFIGURED, LIFE_INACTIVE, LIFE_ACTIVE, LIFE_STOPPING, LIFE_FAULT, LIFE_FINISHED };
enum { COMMAND_NONE, COMMAND_ARM, COMMAND_START, COMMAND_STOP, COMMAND_RESET };
/* Why: bits, latched in `reasons` until COMMAND_RESET. */
enum { WHY_COMMAND = 1, WHY_ESTOP = 2, WHY_PEER = 4, WHY_STALE = 8, WHY_GUARD = 16, WHY_WATCHDOG = 32,
       WHY_OVERRUN = 64, WHY_COMPONENT = 128, WHY_BUS = 256, WHY_SYNC = 512, WHY_APART = 1024,
       WHY_JUMP = 2048 };

typedef struct {
    int32_t state, armed;
    uint32_t reasons;       /* latched */
    uint32_t now;           /* bits raised in this tick, by whoever; cleared by life_step */
    int32_t command;        /* pending, COMMAND_...; cleared by life_step */
    int32_t ramp_ticks;     /* torque goes to 0 in so many ticks while STOPPING */
    int32_t ramp;           /* ticks of the ramp left */
    int32_t reserved;
    double scale;           /* of the torque: 1 ACTIVE, falling STOPPING, 0 else */
} life_t;

/* One tick: applies the command and the bits raised. Returns the state. */
API int32_t life_step(life_t *life);

/* ---- guard: after the controller, before the codec ---- */

enum { GUARD_FINITE = 1, GUARD_TORQUE = 2, GUARD_RATE = 4, GUARD_POSITION = 8, GUARD_VELOCITY = 16,
       GUARD_POWER = 32, GUARD_JUMP = 64 };

typedef struct {
    int32_t joints;
    uint32_t stops;         /* GUARD_ bits that are not only limited but stop the node */
    const double *tau_max;  /* N.m, a joint; NULL: no limit; so below */
    const double *rate_max; /* N.m/s */
    const double *q_low, *q_high;   /* rad: beyond, torque outwards is taken away, and braking added */
    const double *dq_max;   /* rad/s: beyond, torque that accelerates is taken away */
    const double *power_max;/* W, of tau dq, a joint */
    const double *q_jump;   /* rad a tick an encoder may move; more is a fault of the encoder */
    double brake;           /* N.m.s/rad, damping beyond a soft limit */
    double h;               /* s */
    double *last_tau, *last_q;      /* state; last_q NaN: none yet */
    int64_t trips[8];       /* ticks in which each bit was set */
    uint32_t bits;          /* of the last tick */
    uint32_t reserved;
} guard_t;

/* tau (joints,) as the controller wants it -> out (joints,) as it may be. `scale` of the life cycle
 * is applied last, before the rate limit only while ACTIVE (a ramp down is not rate limited).
 * Not finite: 0 for that joint. Returns the GUARD_ bits. q, dq may be NULL. */
API uint32_t guard_apply(guard_t *g, const double *tau, const double *q, const double *dq,
                         double scale, double *out);

/* ---- watchdog: something has to happen every so often ---- */

typedef struct {
    int64_t timeout_ns;     /* 0: off */
    int64_t last_ns;        /* fed; before the first time: armed at */
    int32_t latched, reserved;
    int64_t trips;
} watchdog_t;

API void watchdog_feed(watchdog_t *w, int64_t now_ns);
API int32_t watchdog_check(watchdog_t *w, int64_t now_ns);  /* 1: expired (stays so until reset) */

/* ---- peers: who is there, from heartbeats ---- */

typedef struct {
    watchdog_t heartbeat;
    int32_t state;          /* LIFE_ of the last heartbeat, -1: none yet */
    int32_t required;       /* its loss stops this node */
    uint32_t boots;         /* changes when it restarts */
    uint32_t number;        /* node number */
} peer_t;

/* ---- drive: what a motor drive makes of a torque command; emulated on the plant side ---- */

enum { DRIVE_OFF, DRIVE_READY, DRIVE_ENABLED, DRIVE_FAULT };

typedef struct {
    int32_t joints, state;
    watchdog_t watchdog;    /* of torque commands; latches DRIVE_FAULT */
    const double *tau_max;  /* N.m */
    double lag;             /* s, of the current loop (first order); 0: none */
    double h;               /* s, of the plant's tick */
    double damping;         /* N.m.s/rad, applied in FAULT: a shorted winding; 0: freewheeling */
    double q_lsb, dq_lsb, tau_lsb;  /* encoder and velocity resolution, of the current loop; 0: none */
    double *tau;            /* (joints,) state: torque that acts */
    int64_t faults;
    int32_t accept_simulated;   /* an emulated drive does; a real one must not */
    int32_t reserved;
} drive_t;

/* One tick of the plant: `command` (joints,) as received last -> torque that acts on the joints
 * until the next tick. `valid`: a command has arrived since the last tick and passed its checks. */
API void drive_step(drive_t *d, const double *command, int32_t valid, const double *dq,
                    int64_t now_ns, double *torque);
/* What its encoders say. */
API void drive_measure(const drive_t *d, const double *q, const double *dq, double *q_out,
                       double *dq_out);

#endif
