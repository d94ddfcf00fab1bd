/* commanded.h: a drive with a protocol of its own, as the node sees it that commands it.
 *
 * A drive tells its state in a frame; a table of its profile says what each state means. From ARM on the
 * node brings the drive up, step by step: a frame, then the answer that has to follow in time. A drive is
 * ready when it has told that it is enabled, and a position. Torques go only to a drive that tells that it
 * is enabled. One that tells another state while the node runs, or nothing for too long, stops the node:
 * WHY_DRIVE. The drive is fed with torque 0 before the first slot, and gets the frames that disable it at
 * each end. All times *_ns are those of the frames' stamps: CLOCK_MONOTONIC, or the simulated clock.
 */
#ifndef BRIDGE_COMMANDED_H
#define BRIDGE_COMMANDED_H

#include "frame.h"

/* Meaning of a state. TOLD_OTHER: the frame does not tell a state. */
enum told { TOLD_OTHER, TOLD_DISABLED, TOLD_RAMPING, TOLD_ENABLED, TOLD_FAULT };

/* A state: (word & mask) == value, or != where `differs`; the word is the first eight bytes of the frame,
 * little endian. The first row of a table that fits holds. */
typedef struct {
    uint64_t mask, value;
    int32_t kind, differs;
} told_t;

/* Answer of a step: none; a state among `states`; a frame `answer` whose first eight bytes are `value`
 * under `mask`, and all of `exact` then. */
enum step_kind { STEP_NO_ANSWER, STEP_STATE, STEP_FRAME };

typedef struct {
    frame_t frame; /* `bus`: its number in the node */
    int32_t kind, reserved;
    uint64_t states;             /* STEP_STATE: bits of the rows of `told`, one of which has to follow */
    accept_t answer;             /* STEP_FRAME */
    uint64_t mask, value, exact; /* another value under `exact` is a wrong answer */
    int64_t within_ns;           /* time for the answer */
    int64_t again_ns;            /* the frame is sent again after so long without it; 0: never */
} step_t;

/* Phases. RESTING: nothing is sent. FAILED: its bring-up failed, or it was lost in the run. */
enum phase { DRIVE_RESTING, DRIVE_RISING, DRIVE_SERVING, DRIVE_FAILED };
/* Why a drive failed: no answer or a wrong one to a step; it told another state than enabled; it told
 * nothing for too long; it has another frame format; it answers with the number of another drive; its
 * position stands still while its velocity says that it moves. */
enum failure {
    FAILED_NOT,
    FAILED_ANSWER,
    FAILED_VALUE,
    FAILED_STATE,
    FAILED_SILENT,
    FAILED_FORMAT,
    FAILED_NUMBER,
    FAILED_STILL
};

/* What a drive lacked when START was refused: nothing, its bring-up was not over, a position of now. */
enum lacks { LACKS_NOTHING, LACKS_BRINGUP, LACKS_POSITION };

typedef struct {
    accept_t status; /* the frame that tells its state, whatever its format */
    const told_t *told;
    const step_t *steps; /* from ARM to enabled */
    const frame_t *disabling;
    frame_t feed; /* torque 0 */
    int32_t n_told, n_steps, n_disabling;
    int32_t bus;            /* of the status; its number in the node */
    uint64_t own_mask, own; /* bits of the word that carry its number, and their value */
    uint32_t format;        /* flags of its frames: FRAME_FD or 0 */
    int32_t feeds;          /* 1: torque 0 feeds its watchdog also while it is brought up */
    int64_t within_ns;      /* a state that is older is none; 0: of any age */

    int32_t phase, step;          /* of the bring-up */
    int32_t row;                  /* told last; -1: none of the table, or nothing yet */
    int32_t failure, failed_step; /* failed_step: -1: it was ready before */
    int32_t let_down;             /* FAILED: the frames that disable it were sent */
    uint64_t word, failed_word;   /* as told last; as told when it failed */
    int64_t heard;                /* frames that told a state since its bring-up began */
    int64_t told_ns;              /* -1: nothing yet */
    int64_t began_ns, sent_ns;    /* the step; its frame, 0: not yet */
    int64_t late_ns;              /* for which the node itself stood still since the step began */
    int64_t up_ns;                /* when it became ready */
    int32_t answered;             /* of the step: its frame has come */
    int32_t lacks;                /* LACKS_ when START was refused last */
    int64_t position_ns;          /* LACKS_POSITION: the age of its position then; -1: it has told none */

    int32_t q_of, q_at;   /* its position: number of the message, of the value; -1: none */
    int32_t dq_of, dq_at; /* its velocity */
    int64_t q_newest;     /* sample of the position that was looked at last; -1: none */
    double q_last, moved; /* that position; way by its velocity since it changed last, rad */
} commanded_t;

/* A change of what a drive tells, or of its phase; the first `capacity` are kept. */
typedef struct {
    int64_t t_ns;
    int32_t drive, phase, row, failure;
    uint64_t word;
} drive_event_t;

typedef struct {
    drive_event_t *events;
    int64_t n, capacity;
} drive_events_t;

#endif
