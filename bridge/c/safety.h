/* safety.h: what stands between a controller and a motor. Deterministic: its inputs are recorded,
 * so a replay takes the same decisions. Every rule, and how to reset it: docs/safety.md.
 *
 * life.c: life cycle, watchdogs, peers.  guard.c: guard.  drive.c: drive.
 */
#ifndef BRIDGE_SAFETY_H
#define BRIDGE_SAFETY_H

#include <stddef.h>
#include <stdint.h>

#include "frame.h"

enum { SAFETY_JOINTS = 32 };     /* the most joints a guard or a drive can have */

/* ---- status: the byte that travels with every sample ---- */

enum { STATUS_LIFE = 7 /* mask: LIFE_ of the sender */, STATUS_DEADMAN = 8 /* held */,
       STATUS_ESTOP = 16 /* latched */, STATUS_SATURATED = 32, STATUS_STALE = 64,
       STATUS_SIMULATED = 128 /* a rehearsal: never for a real drive */ };

/* ---- life cycle: of a node ---- */

enum { LIFE_UNCONFIGURED, LIFE_INACTIVE, LIFE_ACTIVE, LIFE_STOPPING, LIFE_FAULT, LIFE_FINISHED };
enum { COMMAND_NONE, COMMAND_ARM, COMMAND_START, COMMAND_STOP, COMMAND_RESET };
/* The commands of one slot, in the order in which they came: octal digits, the first is the lowest. Of
 * more than ten the last ones are dropped, but never a STOP. */
enum { COMMANDS_BITS = 30 };
static inline uint32_t commands_add(uint32_t commands, int32_t command)
{
    int32_t bit = 0;
    while (bit < COMMANDS_BITS && commands >> bit & 7) bit += 3;
    if (bit == COMMANDS_BITS && command != COMMAND_STOP) return commands;
    if (bit == COMMANDS_BITS) bit -= 3, commands &= ~((uint32_t)7 << bit);
    return commands | (uint32_t)(command & 7) << bit;
}
/* Whether this command is among them. */
static inline int32_t commands_have(uint32_t commands, int32_t command)
{
    for (; commands; commands >>= 3)
        if ((int32_t)(commands & 7) == command) return 1;
    return 0;
}
/* Why: bits, latched in `reasons` until COMMAND_RESET. */
enum { WHY_COMMAND = 1, WHY_ESTOP = 2, WHY_PEER = 4, WHY_STALE = 8, WHY_GUARD = 16, WHY_WATCHDOG = 32,
       WHY_OVERRUN = 64, WHY_COMPONENT = 128, WHY_BUS = 256, WHY_SYNC = 512, WHY_APART = 1024,
       WHY_JUMP = 2048 };
/* What is so before everybody is there: while INACTIVE and not armed these refuse ARM and START in
 * the tick that raises them, and are not latched. */
enum { WHY_NOT_YET = WHY_PEER | WHY_STALE | WHY_WATCHDOG | WHY_OVERRUN | WHY_SYNC | WHY_APART };

typedef struct {
    int32_t state, armed;
    uint32_t reasons;       /* latched */
    uint32_t now;           /* bits raised in this tick, by whoever; cleared by life_step */
    uint32_t commands;      /* of this tick; cleared by life_step */
    int32_t ramp_ticks;     /* torque goes to 0 in so many ticks while STOPPING */
    int32_t ramp;           /* ticks of the ramp left */
    uint32_t refused;       /* why the last command was refused, WHY_COMMAND: not in this state; 0: it was not */
    double scale;           /* of the torque: 1 ACTIVE, falling STOPPING, 0 else */
} life_t;

/* One tick: applies the commands in their order, then the bits raised, which win. A STOP among them is
 * applied alone, and with an emergency stop (WHY_ESTOP raised) only a STOP is: the others are refused.
 * Returns the state.
 *
 *   ARM    INACTIVE, nothing latched, nothing raised            -> armed
 *   START  INACTIVE, armed, nothing latched, nothing raised     -> ACTIVE
 *   STOP   ACTIVE -> STOPPING, at the end of the ramp INACTIVE; INACTIVE: disarmed
 *   RESET  INACTIVE, FAULT -> INACTIVE, disarmed, nothing latched
 *   a bit  ACTIVE -> STOPPING, at the end of the ramp FAULT; INACTIVE -> FAULT (but see WHY_NOT_YET)
 *
 * UNCONFIGURED -> INACTIVE and any -> FINISHED are the node's. A node that is done raises STOP first.
 * A state or a command that does not exist is a fault of the node: WHY_COMPONENT. */
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
    const double *power_max;/* W, of tau dq, a joint; braking (tau dq < 0) is not limited */
    const double *q_jump;   /* rad a tick an encoder may move; more is a fault of the encoder */
    double brake;           /* N.m.s/rad, damping beyond a soft limit, while moving outwards */
    double h;               /* s */
    double *last_tau, *last_q;      /* state; last_q NaN: none yet */
    int64_t trips[8];       /* ticks in which each bit was set */
    uint32_t bits;          /* of the last tick */
    uint32_t reserved;
} guard_t;

/* tau (joints,) as the controller wants it -> out (joints,) as it may be. Returns the GUARD_ bits.
 * q, dq may be NULL: then what needs them is not checked.
 *
 * In this order, for each joint: finite (tau, q, dq; else 0), encoder jump (else 0), tau_max,
 * rate_max, q_low..q_high, dq_max, power_max, brake, tau_max again, and last `scale` of the life
 * cycle. What is taken away is away at once; what comes back comes at rate_max. The rate is that of
 * the torque before `scale`: a ramp down is not rate limited, the controller behind it is; after
 * scale = 0 the torque starts from 0. `out` is finite and within tau_max whatever comes in. */
API uint32_t guard_apply(guard_t *g, const double *tau, const double *q, const double *dq,
                         double scale, double *out);
/* WHY_ bits that the last tick's GUARD_ bits raise: those in `stops`. */
API uint32_t guard_why(const guard_t *g);

/* ---- watchdog: something has to happen every so often ---- */

typedef struct {
    int64_t timeout_ns;     /* 0: off */
    int64_t last_ns;        /* fed; before the first time: armed at */
    int32_t latched, reserved;
    int64_t trips;
} watchdog_t;

API void watchdog_feed(watchdog_t *w, int64_t now_ns);      /* does not unlatch */
API int32_t watchdog_check(watchdog_t *w, int64_t now_ns);  /* 1: expired (stays so until reset) */
API void watchdog_reset(watchdog_t *w, int64_t now_ns);     /* unlatched, and fed now */

/* ---- peers: who is there, from heartbeats ---- */

typedef struct {
    watchdog_t heartbeat;
    int32_t state;          /* LIFE_ of the last heartbeat, -1: none yet */
    int32_t required;       /* its loss stops this node */
    uint32_t boots;         /* changes when it restarts */
    uint32_t number;        /* node number */
} peer_t;

/* A heartbeat has arrived. The life cycle latches, not the peer: a peer heard again is there again.
 * Returns WHY_PEER when a required peer has restarted, else 0. */
API uint32_t peer_heartbeat(peer_t *peer, int32_t state, uint32_t boots, int64_t now_ns);
/* WHY_PEER while a required peer is silent, STOPPING or in FAULT; one that has FINISHED may be silent. */
API uint32_t peer_check(peer_t *peer, int64_t now_ns);

/* ---- drive: what a motor drive makes of a torque command; emulated on the plant side ---- */

enum { DRIVE_OFF, DRIVE_READY, DRIVE_ENABLED, DRIVE_FAULT };
enum { DRIVE_POWER_ON = 1, DRIVE_ENABLE, DRIVE_DISABLE, DRIVE_CLEAR, DRIVE_POWER_OFF };

typedef struct {
    int32_t joints, state;
    watchdog_t watchdog;    /* of torque commands; latches DRIVE_FAULT */
    const double *tau_max;  /* N.m; NULL: no limit */
    double lag;             /* s, of the current loop (first order); 0: none */
    double h;               /* s, of the plant's tick */
    double damping;         /* N.m.s/rad, applied in FAULT: a shorted winding; 0: freewheeling */
    double q_lsb, dq_lsb, tau_lsb;  /* encoder and velocity resolution, of the current loop; 0: none */
    double *tau;            /* (joints,) state: torque of the current loop at the end of the tick */
    int64_t faults;
} drive_t;

/* OFF -ON-> READY -ENABLE-> ENABLED -DISABLE-> READY, FAULT -CLEAR-> READY, any -OFF-> OFF. A request
 * that does not fit changes nothing: FAULT is left by CLEAR (or OFF) only. Returns the state. */
API int32_t drive_request(drive_t *d, int32_t request, int64_t now_ns);
/* One tick of the plant: `command` (joints,) as received last -> torque that acts on the joints
 * until the next tick, the mean of what the current loop gives over it. `valid`: a command has
 * arrived since the last tick and passed its checks. A command that is not finite, or its
 * absence for longer than the watchdog allows, is a FAULT. */
API void drive_step(drive_t *d, const double *command, int32_t valid, const double *dq,
                    int64_t now_ns, double *torque);
/* What its encoders say. */
API void drive_measure(const drive_t *d, const double *q, const double *dq, double *q_out,
                       double *dq_out);

#endif
