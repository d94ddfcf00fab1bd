/* gates.h: what signals go through where they leave or enter a node: outlets, what others make of
 * their messages, receptions, inlets. */
#ifndef BRIDGE_GATES_H
#define BRIDGE_GATES_H

#include "commanded.h"
#include "delay.h"
#include "drive.h"
#include "guard.h"
#include "limit.h"
#include "message.h"
#include "motor.h"
#include "pace.h"
#include "receiver.h"
#include "rows.h"

struct node;

/* A message made of another one as it comes: what gateways do. */
typedef struct {
    const message_t *message;
    const int32_t *sources; /* values of the message it is made of, one a value */
    double *values;         /* forwarded last, `width` */
    int32_t width, bus;
    history_t *of, *to;   /* replay: of the two messages; else NULL */
    int64_t sent, failed; /* samples; failed: not handed over */
    histogram_t transit;  /* wall clock: from arrival to hand-over */
} forward_t;

typedef struct {
    struct node *node;
    const message_t *message;
    int32_t width, bus;
    const int64_t *sources;          /* signals, one a value */
    double *values;                  /* sent */
    int64_t every, hit_ticks;        /* hits between two messages; ticks of a hit */
    guard_t *guard;                  /* or NULL */
    int32_t guarded, joints;         /* first value of the torque, how many */
    int64_t q, dq;                   /* signals for the guard; -1: none */
    drive_t *drive;                  /* measures what is sent; or NULL */
    int32_t measured_q, measured_dq; /* first values of position, velocity; -1: none */
    history_t *history;              /* filled with what was sent: replay; else NULL */
    int64_t sent, saturated;         /* messages; those with values that did not fit */
    forward_t *forwards; /* replay: what gateways have made of it, each behind what it is made of */
    int64_t n_forwards;
    commanded_t *commanded; /* the drive of a vendor that it commands: all values are torques; or NULL */
    motor_t *motor;         /* the emulated drive whose feedback it is, of this kind; or NULL */
    int64_t part;
} outlet_t;

/* A torque that stays inside the node: guarded in place, right after its component has computed it. */
typedef struct {
    struct node *node;
    guard_t *guard;
    int64_t tau, q, dq; /* signals; q, dq -1: none */
} inside_t;

/* A message that this node receives. */
typedef struct {
    const message_t *message;
    receiver_t *receiver;
    double *values; /* decoded, `width` */
    int32_t width, bus;
    int64_t period_ns;          /* of the sender */
    int64_t offset_ns;          /* phase of the sender: nominal time of sample j is j*period + offset */
    const limit_t *limits;      /* what its values may be, `width`; NULL: anything */
    int64_t max_age_ns;         /* older at its arrival is refused: by its stamp, else by the nominal time
                             * of its number; 0: any */
    int64_t newest, arrival_ns; /* accepted last; -1: none */
    int64_t previewed_ns;       /* arrival of the last preview, on the clock of its frame; -1: none */
    int32_t accept_simulated;
    int32_t awaited;    /* no start before it was received, if its status marks previews */
    int32_t of_fault;   /* 1: torques of a node in FAULT were received; they do not count as samples */
    int32_t drive;      /* positions of this drive, of those the node commands; -1: of none */
    int64_t transit_ns; /* of the newest: arrival less nominal time, of the stamp or the number */
    history_t *history; /* its received samples, in a replay; else NULL */
    int32_t sender;     /* number of the node that sends it */
    int32_t n_forwards;
    forward_t *forwards; /* messages that are sent on when a sample of this one is accepted */
    int64_t promised;    /* lock-step: number of the newest sample that was sent, and may still be on its
                             * way because no delay line gives it yet; -1: there are no such samples */
    int64_t early_range; /* before the start: frames out of range, */
    int64_t misfits;     /* of its identifier in another format, */
    int64_t early;       /* and samples of a run whose t = 0 is not known here, */
    int32_t early_life;  /* the last of them from a sender in this state */
    int32_t reserved2;
    int64_t early_ns; /* and arrived so long after its time stamp */
} reception_t;

typedef struct {
    struct node *node;
    reception_t *reception;
    delay_t *delay;
    int32_t first, count; /* of the message's values */
    int64_t target;       /* into signals */
    double gain, offset;
    int64_t age;          /* signal that gets the time since the last arrival, s; -1: none */
    int64_t stop_ns;      /* silence that stops the node; 0: never */
    int64_t period;       /* ticks of the receiver */
    drive_t *drive;       /* between this and the plant; or NULL */
    int64_t max_age_ns;   /* drive: an older torque is not given, and feeds no watchdog; 0: any */
    int64_t q, dq;        /* of the plant, for the drive: signals */
    double *command;      /* (count,): drive: what was received */
    int64_t held, newest; /* of this tick */
    int64_t last_newest;
    int64_t heard_ns; /* when the newest arrived, by slots: staleness is deterministic */
    double *initial;  /* (count,): initial values, which it also uses after its samples are gone */
    int32_t begun, reserved;
    int64_t link_age; /* signal that gets the age of the sample held, s; -1: none */
    int64_t later;    /* 1: a row is written before this is passed (plants), else 0 */
    motor_t *motor;   /* the drive is that of a vendor, who decides whether torque acts; or NULL */
    int64_t ignored;  /* of a drive: torques until this one, received before it was enabled, do not act */
    const motor_fault_t *faults; /* of a drive of our own protocol, in the order of time: VENDOR_TRIP, HOT, */
    int32_t n_faults, happened;  /* DROP, and REBOOT with code 1: its power goes, 0: comes */
    int32_t hot, drops;          /* of these faults, while they last */
    uint32_t asked, reserved3;   /* requests that they make, as commands_add packs them, */
    int64_t requests;            /* and those of this pass, which are in the journal */
    int32_t tripped, reserved2;  /* its FAULT is not of its watchdog */
} inlet_t;

/* Whether a message contains the state of its sender: a status of 4 bits (classic CAN) does not. */
static inline int32_t tells_life(const message_t *m)
{
    return m->status >= 0 && m->header[m->status].scale == 1.0;
}

#endif
