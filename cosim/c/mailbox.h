/* mailbox.h: an FMU in a process of its own, which is stepped through memory that both processes share.
 *
 * Each side counts its messages. A side that waits polls for a few microseconds, as long as polling has
 * succeeded lately, and then sleeps: in a futex on Linux, elsewhere until a byte comes through
 * a pipe. A pipe whose other end is closed tells both that the other side has ended. */
#ifndef COSIM_MAILBOX_H
#define COSIM_MAILBOX_H

#include "engine.h"

enum ask { ASK_STEP, ASK_CALL };
enum lost { LOST_NOT, LOST_ENDED, LOST_LATE, LOST_STOPPED };

/* In the shared memory; what one side writes and what the other does are in cache lines of their own. */
typedef struct {
    uint32_t asked, asked_asleep;
    int32_t what;
    int32_t stop; /* not 0: a step shall return as early as it can */
    double t;     /* s */
    int64_t hit, apart1[4];
    uint32_t answered, answered_asleep;
    int32_t result, status;
    int32_t failed, apart2; /* the signal at fault, among the shared ones */
    double reached;         /* s */
    int64_t apart3[4];
} mailbox_t;

/* One side's own part of it. */
typedef struct {
    mailbox_t *box;
    double *signals;       /* shared: inputs, outputs, slopes */
    unit_t *unit;          /* of the side with the FMU */
    const int64_t *slopes; /* of the other side: where slopes are in its signals */
    const int32_t *stop;   /* set if it shall not wait much longer; or NULL */
    double patience;       /* s, for a step */
    int64_t n_slopes;
    uint32_t seen;              /* what it has of the other side */
    int32_t incoming, outgoing; /* pipes */
    int32_t bytes;              /* not 0: they wake, rather than a futex */
    int32_t eager, calm;        /* looks that may still fail; waits since the last one */
} mail_end_t;

/* Ask for something; for a step, with the inputs in `s`. */
void mailbox_ask(const unit_t *u, const double *s, double t, int64_t hit);
/* The result of a step: the outputs are in `s`. RUN_LOST: *status is LOST_... */
int32_t mailbox_answer(const unit_t *u, double *s, double *reached, int *status, int32_t *failed);
/* The side with the FMU: wait for what is asked next, ASK_..., -1: the other side has ended. */
int32_t mailbox_asked(mail_end_t *x);
API void engine_answer(mail_end_t *x);

#endif
