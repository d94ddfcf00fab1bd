/* drive.h: the response of a motor drive to a torque command; emulated on the plant side.
 *
 * Deterministic: its inputs are recorded, so a replay takes the same decisions. docs/safety.md describes
 * every rule and how to reset it. */
#ifndef BRIDGE_DRIVE_H
#define BRIDGE_DRIVE_H

#include <stdint.h>

#include "frame.h"
#include "watchdog.h"

enum drive_state { DRIVE_OFF, DRIVE_READY, DRIVE_ENABLED, DRIVE_FAULT };
enum drive_request {
    DRIVE_POWER_ON = 1,
    DRIVE_ENABLE,
    DRIVE_DISABLE,
    DRIVE_CLEAR,
    DRIVE_POWER_OFF,
    DRIVE_TRIP
};

typedef struct {
    int32_t joints, state;
    watchdog_t watchdog;           /* of torque commands; latches DRIVE_FAULT */
    const double *tau_max;         /* N.m; NULL: no limit */
    double lag;                    /* s, of the current loop (first order); 0: none */
    double h;                      /* s, of the plant's tick */
    double damping;                /* N.m.s/rad, applied in FAULT: a shorted winding; 0: freewheeling */
    double q_lsb, dq_lsb, tau_lsb; /* encoder and velocity resolution, of the current loop; 0: none */
    double *tau;                   /* (joints,) state: torque of the current loop at the end of the tick */
    int64_t faults;
} drive_t;

/* OFF -ON-> READY -ENABLE-> ENABLED -DISABLE-> READY, FAULT -CLEAR-> READY, any -OFF-> OFF, and with power
 * any -TRIP-> FAULT, which is not requested. A request
 * that does not fit changes nothing: FAULT is left by CLEAR (or OFF) only. Returns the state. */
API int32_t drive_request(drive_t *d, int32_t request, int64_t now_ns);
/* One tick of the plant: `command` (joints,) as received last -> torque that acts on the joints
 * until the next tick, the mean of what the current loop gives over it. `valid`: a command has
 * arrived since the last tick and passed its checks. A command that is not finite, or its
 * absence for longer than the watchdog allows, is a FAULT. */
API void drive_step(drive_t *d, const double *command, int32_t valid, const double *dq, int64_t now_ns,
                    double *torque);
/* Values of its encoders. */
API void drive_measure(const drive_t *d, const double *q, const double *dq, double *q_out, double *dq_out);

#endif
