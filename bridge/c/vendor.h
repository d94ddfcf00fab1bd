/* vendor.h: one motor drive as its vendor describes it: what it hears, its states, errors and answers.
 *
 * The plant's side of the bus. A node that commands drives knows them by a profile; the tables here are
 * written from the vendors' documents without it, so that a misreading shows. Pure: time and frames come
 * in, frames go out, nothing is allocated or read. The result depends on frames and times, not on how
 * often vendor_step is called.
 */
#ifndef BRIDGE_VENDOR_H
#define BRIDGE_VENDOR_H

#include <stdint.h>

#include "frame.h"

enum vendor_kind { VENDOR_DAMIAO = 1, VENDOR_ODRIVE, VENDOR_CIA402 };
/* Faults; what `code` says. TRIP: the drive's own error code. REBOOT. UNPLUG, PLUG: of its CAN cable; the
 * drive itself goes on. LATE: ns by which each answer is later, 0: none. OTHER_ID: added to the identifiers
 * it sends, 0: none. OLD: 1: sends the positions of now for ever, 0: no more. HOT: over-temperature (1: of
 * the electronics, 2: of the motor) that no request clears, 0: cool again. DROP: 1: is enabled and leaves
 * that state at its next cycle, without an error, 0: no more. */
enum vendor_fault {
    VENDOR_TRIP = 1,
    VENDOR_REBOOT,
    VENDOR_UNPLUG,
    VENDOR_PLUG,
    VENDOR_LATE,
    VENDOR_OTHER_ID,
    VENDOR_OLD,
    VENDOR_HOT,
    VENDOR_DROP
};
enum { VENDOR_QUEUE = 16, VENDOR_PARTS = 2 };

typedef struct {
    /* as it is configured; set before vendor_init */
    int32_t kind, node;           /* VENDOR_DAMIAO ...; its number on the bus */
    int32_t format;               /* of what it sends: FRAME_FD | FRAME_BRS, or 0: classic */
    int32_t host;                 /* CiA 402: node whose heartbeats it waits for (0x1016), 0: none */
    int64_t timeout_ns;           /* of its watchdog, 0: off */
    int64_t cycle_ns;             /* of its control loop: a transition takes until the next one */
    int64_t boot_ns;              /* from power to the first frame it hears */
    int64_t answer_ns, jitter_ns; /* it sends so long after a request, and up to so much longer */
    int64_t beat_ns;              /* between its own heartbeats, 0: none */
    double p_max, v_max, t_max;   /* Damiao: registers 21 to 23 */
    double rated;                 /* CiA 402: rated torque (0x6076), N.m */
    uint64_t seed;

    /* what it does */
    int32_t acts;              /* 1: the torque commanded acts on the motor */
    int32_t state;             /* of its vendor: nibble of a feedback, axis state, index of a CiA 402 state */
    uint32_t error;            /* code of its vendor, 0: none */
    int32_t result;            /* ODrive: of the last request (procedure_result) */
    int32_t network, reserved; /* CiA 402: NMT state; others: 1 when it has booted; all: 0 before */
    double tau;                /* N.m at the motor, commanded last; it acts while `acts` is 1 */
    int32_t owed[VENDOR_PARTS]; /* feedback frames of this kind that it has to send */
    int64_t refused;            /* torques other than 0 while it was not enabled */
    int64_t unheard;            /* frames to it in a format that it does not hear */
    int64_t trips, lost;        /* faults it has entered; frames that did not fit into its queue */

    /* its own */
    int64_t now_ns, booted_ns, fed_ns, due_ns, beat_due_ns, ramp_ns;
    int64_t asked_ns[VENDOR_PARTS]; /* when the first feedback frame that it owes was asked for */
    int64_t late_ns, last_ns;       /* LATE; when the newest frame of the queue is due */
    uint64_t draw;
    uint32_t saved, word, before; /* Damiao: TIMEOUT as stored; CiA 402: control words */
    int32_t mode, input, plugged, hot, drops, shift;
    int32_t old;              /* OLD; 2: the frames to repeat are there */
    int32_t n_queue, n_ready; /* of the queue; the first of them are sent, and wait for vendor_next */
    uint8_t kept[VENDOR_PARTS][8];
    frame_t queue[VENDOR_QUEUE];
} vendor_t;

/* As after power-up long ago: booted, disabled, no error. */
API void vendor_init(vendor_t *v, int64_t t_ns);
/* As a bring-up leaves it: enabled, its watchdog fed now. */
API void vendor_brought_up(vendor_t *v, int64_t t_ns);
/* A frame of its bus, which it heard at t_ns; its own answers are in its queue afterwards. Returns 1 if it
 * is for this drive and asks for something else than torque. */
API int32_t vendor_take(vendor_t *v, const frame_t *frame, int64_t t_ns);
/* All that has happened until t_ns: watchdog, transitions, cyclic frames. */
API void vendor_step(vendor_t *v, int64_t t_ns);
/* A feedback frame of kind `part` (0: the one with its state, 1: a second one), with the values of t_ns:
 * it goes into the queue, and what is of the drive (status, error, temperatures) is written into it. Nothing
 * happens if the drive owes none: Damiao sends one for a command, CiA 402 for a SYNC, ODrive by itself.
 * Its time of answer began with that command. */
API void vendor_say(vendor_t *v, int32_t part, const frame_t *frame, int64_t t_ns);
/* The next frame that it sends until t_ns (its t_ns: when): 1, or 0: none. */
API int32_t vendor_next(vendor_t *v, int64_t t_ns, frame_t *frame);
API void vendor_fault(vendor_t *v, int32_t fault, int32_t code, int64_t t_ns);

/* For its kind: a frame of its own into the queue, `part` -1: nothing is written into it at its sending. */
void vendor_queue(vendor_t *v, uint32_t id, int32_t format, const uint8_t *data, int32_t length,
                  int64_t t_ns);
/* The power is switched off and on. */
void vendor_reboot(vendor_t *v, int64_t t_ns);

#endif
