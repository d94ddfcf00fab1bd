/* participant.h: a node of a deployment in C99, for programs that are not this project's.
 *
 * The participant reads no clock, opens no socket and allocates nothing. Its owner passes received frames to
 * it (participant_hear), calls participant_poll when it is time, and sends frames for it (`send`). The
 * owner's law is `step`: received values in, values to send out, once a slot. Everything else is done here:
 * layouts, checksums, sequence numbers, start, clock, heartbeats, life cycle, watchdogs.
 *
 * The protocol: docs/participants.md. The table of a deployment's node is written by `cosim new participant`.
 * Times are ns; `now_ns` is of any clock that only goes forward.
 */
#ifndef PARTICIPANT_H
#define PARTICIPANT_H

#include <stddef.h>
#include <stdint.h>

#include "life_cycle.h"
#include "limit.h"
#include "message.h"
#include "receiver.h"
#include "watchdog.h"

enum { PARTICIPANT_INPUTS = 16, PARTICIPANT_OUTPUTS = 8, PARTICIPANT_PEERS = 31 };
enum { PARTICIPANT_BUSES = 8, PARTICIPANT_VALUES = 64 /* of a message */ };

/* ---- the table: what the deployment says of this node ---- */

/* A message that it receives. */
typedef struct {
    const char *name, *key; /* of the deployment; on Zenoh, NULL on CAN */
    message_t layout;
    int32_t bus, sender;          /* number in `buses`; number of the node that sends it */
    int64_t period_ns, offset_ns; /* nominal time of sample j: j * period + offset */
    int64_t max_age_ns;           /* older at its arrival is refused; 0: any */
    int64_t stop_ns;              /* a longer silence stops the node (stale); 0: none does */
    int64_t watchdog_ns;          /* the same of a drive's torque (watchdog); 0: none */
    int32_t torque, awaited;      /* it has torques of a drive; no start before it was received */
    const limit_t *limits;        /* of each value; NULL: none */
} received_t;

/* A message that it sends. */
typedef struct {
    const char *name, *key;
    message_t layout;
    int32_t bus, every;            /* slots between two of them */
    int32_t first_torque, torques; /* values that are 0 unless the node is ACTIVE */
    const double *start, *tau_max; /* before the first slot; of torques, NULL: no limit */
} sent_t;

/* Another node, and its heartbeat on a bus. */
typedef struct {
    const char *name, *key;
    message_t heartbeat;
    int32_t bus, number, required, takes; /* takes: its drives take torques of this node */
    int64_t within_ns;                    /* silence after which it is lost */
} neighbour_t;

/* Services of a bus; one that is NULL is neither sent nor obeyed there. */
typedef struct {
    const char *name, *prefix; /* of the deployment; of keys on Zenoh, NULL on CAN */
    const char *heartbeat_key, *nmt_key, *estop_key, *epoch_key; /* Zenoh */
    const message_t *heartbeat, *nmt, *estop, *epoch, *sync;
} bus_table_t;

typedef struct {
    const char *node;
    int32_t number, simulated; /* simulated: of a rehearsal, never for a real drive */
    int64_t h_ns, phase_ns, slots;
    int64_t heartbeat_slots, sync_slots, ramp_slots; /* 0: none */
    int64_t overrun_ns, patience_ns;
    int32_t n_buses, n_received, n_sent, n_neighbours;
    const bus_table_t *buses;
    const received_t *received;
    const sent_t *sent;
    const neighbour_t *neighbours;
} participant_table_t;

/* ---- the participant ---- */

typedef struct {
    receiver_t receiver;
    double values[PARTICIPANT_VALUES]; /* accepted last, or of a preview */
    int64_t newest, arrival_ns;        /* accepted last: its number, since t = 0; -1: none */
    int64_t previewed_ns;              /* a preview came; -1: none */
    int64_t early_ns;                  /* of a sample of a run whose t = 0 is unknown: arrival - stamp */
    int32_t early;                     /* how many there were */
    uint32_t status;                   /* accepted last */
} input_t;

typedef struct {
    double values[PARTICIPANT_VALUES]; /* step writes them */
    int64_t frames, saturated;
} output_t;

/* The host's clock, which its owner fills in: see host.h for Linux. */
typedef struct {
    int32_t number, kept;   /* 1 to 255; 1: a time server keeps its date */
    double identity[4];     /* 32 bits each; all 0: not known */
    double error;           /* s, of its date, if kept */
    int64_t date_offset_ns; /* date (ns since 1970) less now_ns; refresh it once a second */
    char text[64];          /* the boot id */
} participant_host_t;

typedef struct participant participant_t;
typedef void (*participant_send_t)(void *context, int32_t bus, const frame_t *frame, const char *key);
typedef void (*participant_step_t)(void *context, participant_t *p, double t, double h);

struct participant {
    const participant_table_t *table;
    void *context;
    participant_send_t send;
    participant_step_t step;
    participant_host_t host;
    input_t inputs[PARTICIPANT_INPUTS];    /* in the order of the table */
    output_t outputs[PARTICIPANT_OUTPUTS]; /* the same */
    peer_t peers[PARTICIPANT_PEERS];
    life_t life;
    uint32_t boots, beats, syncs, epochs; /* boots: another one for each start of the program */
    int64_t now_ns, start_ns;             /* t = 0; 0: not known */
    int64_t slot, first_slot, missed;
    int32_t begun, over, follows, run;
    int64_t nmt_ns;                             /* t = 0 of the last START */
    int64_t start_from, start_until, arm_until; /* when they may be obeyed; 0: none waits */
    int64_t beat_ns;
    int64_t origin_ns, epoch_ns; /* t = 0 of the last EPOCH that is believed, and when it came */
    int64_t epoch_due_ns, date_ns, date_apart_ns;
    int64_t named_ns; /* when the last HOST came; 0: an EPOCH has come since */
    double named;     /* what it said */
    int32_t named_host, told, date_host, running, asked;
    int32_t alarms, alarm_own;
    int64_t alarm_ns;
    int64_t damaged, unknown, refusals; /* frames of services; of nothing known; START or ARM refused */
    uint32_t refused;
    int32_t stopping;
};

API void participant_init(participant_t *p, const participant_table_t *table, participant_send_t send,
                          participant_step_t step, void *context);
/* A frame that arrived at frame->t_ns on frame->bus (a number in the table). On Zenoh its id is the one of
 * its subscription. */
API void participant_hear(participant_t *p, const frame_t *frame);
/* Does what is due. Returns until when it has to be called again, or -1: the participant has ended. */
API int64_t participant_poll(participant_t *p, int64_t now_ns);
/* A command of its owner, COMMAND_ARM, _START (needs participant_begin), _STOP, _RESET. */
API void participant_command(participant_t *p, int32_t command);
/* START with this t = 0; the other nodes are told by EPOCH, not started. */
API void participant_begin(participant_t *p, int64_t start_ns);
/* Emergency stop of all nodes, until RESET. */
API void participant_estop(participant_t *p);
/* 1: it has received what it needs, and a START would be obeyed. On Zenoh: declare the token. */
API int32_t participant_ready(const participant_t *p);
/* The end at once: torque 0, and FINISHED or FAULT. */
API void participant_end(participant_t *p);

/* The values of received message i, and those of message i that it sends, for other languages. */
API const double *participant_input(const participant_t *p, int32_t i);
API double *participant_output(participant_t *p, int32_t i);
/* By how much torque acts: 1 while it is ACTIVE, falling to 0 while it stops, else 0. */
API double participant_scale(const participant_t *p);
/* Bytes of a participant_t, and its clock: the two that a program in another language has to know. */
API int32_t participant_size(void);
API participant_host_t *participant_host(participant_t *p);

/* Zenoh: the key of subscription i, the bus and the id of its frames; NULL: there are no more. */
API const char *participant_subscription(const participant_t *p, int32_t i, int32_t *bus, uint32_t *id);
/* Answers to the queries "state", "parameters" and "clock" as JSON, into `text`; bytes without the 0. */
API int32_t participant_answer(const participant_t *p, const char *what, char *text, int32_t size);

#endif
