/* node.h: one node's slot, on whatever clock.
 *
 * A slot: drain the buses, step the life cycle, run one tick of the plan (whose gates are inlets and
 * outlets), write a row of the journal. Nothing here allocates, prints or waits; waiting is
 * node_live's, between slots. All times named *_ns are relative to the start of the run, except
 * start_ns and deadlines of pace.h.
 */
#ifndef BRIDGE_NODE_H
#define BRIDGE_NODE_H

#include <stddef.h>

#include "bus.h"
#include "delay.h"
#include "epoch.h"
#include "faults.h"
#include "journal.h"
#include "message.h"
#include "pace.h"
#include "safety.h"

enum { CLOCK_WALL = 1, CLOCK_SIMULATED = 2, CLOCK_REPLAY = 3 };
/* Bits of a row. */
enum { ROW_BURST = 1 /* a missed slot, done late */, ROW_FAILED = 2 /* a component failed in it */,
       ROW_DISABLED = 4, ROW_ENABLED = 8 /* the drives it commands were, behind the torques of this slot */ };
/* What node_live returns; positive: of engine_run. */
enum { LIVE_FINISHED = 0, LIVE_STOPPED = -1, LIVE_NEVER_STARTED = -2, LIVE_FAULT = -3 /* came to the end in FAULT */,
       LIVE_NOT_JOINED = -4 };
/* Values of heartbeats and NMT, in this order. */
enum { HEARTBEAT_LIFE, HEARTBEAT_WHY, HEARTBEAT_BOOTS, HEARTBEAT_ARMED, HEARTBEAT_VALUES };
enum { NMT_COMMAND, NMT_NODE, NMT_VALUES };
enum { ESTOP_NODE, ESTOP_REASONS, ESTOP_VALUES };
enum { NMT_START = 1, NMT_STOP = 2, NMT_ARM = 128, NMT_RESET = 129 };

/* The messages of one bus besides the deployment's, as this node says and hears them there. A message
 * that is NULL does not exist on this bus: it is neither sent nor obeyed. */
typedef struct {
    const message_t *heartbeat; /* of this node */
    const message_t *sync, *nmt, *estop, *epoch;
    const message_t **peers;    /* heartbeats of the node's peers, one a peer; NULL in it: not here */
    const message_t *host_heartbeat, *host_sync;    /* CANopen's, for drives that this node commands */
    int64_t host_sync_slots;    /* slots between two of them */
} services_t;

/* Emergency stop of this node: none, to be obeyed, its own until RESET. */
enum { ALARM_NONE, ALARM_RAISED, ALARM_OURS };

struct node;

/* Of a sample in a replay: not known, or there. */
enum { SAMPLE_UNKNOWN, SAMPLE_THERE };

/* Decoded samples of one message, by sequence number: in a replay what a reception has heard, and
 * what an outlet sends again. */
typedef struct {
    int64_t first, count, capacity;
    int32_t width, reserved;
    double *values;         /* capacity rows */
    uint8_t *there;         /* capacity, SAMPLE_... */
} history_t;

/* A message made of another one as it comes: what gateways do. */
typedef struct {
    const message_t *message;
    const int32_t *sources; /* values of the message it is made of, one a value */
    double *values;         /* forwarded last, `width` */
    int32_t width, bus;
    history_t *of, *to;     /* replay: of the two messages; else NULL */
    int64_t sent, failed;   /* samples; failed: not handed over */
    histogram_t transit;    /* wall clock: from arrival to hand-over */
} forward_t;

/* A message this node hears. */
typedef struct {
    const message_t *message;
    receiver_t *receiver;
    double *values;         /* decoded, `width` */
    int32_t width, bus;
    int64_t period_ns;      /* of the sender */
    int64_t offset_ns;      /* phase of the sender: nominal time of sample j is j*period + offset */
    const limit_t *limits;  /* what its values may be, `width`; NULL: anything */
    int64_t max_age_ns;     /* older at its arrival is refused: by its stamp, else by the nominal time
                             * of its number; 0: any */
    int64_t newest, arrival_ns; /* accepted last; -1: none */
    int64_t previewed_ns;   /* arrival of the last preview, on the clock of its frame; -1: none */
    int32_t accept_simulated;
    int32_t awaited;        /* no start before it was heard, if it tells previews */
    int32_t of_fault;       /* 1: torques of a node in FAULT were heard: they are no samples that count */
    int32_t reserved;
    int64_t transit_ns;     /* of the newest: arrival less nominal time, of the stamp or the number */
    history_t *history;     /* what was heard of it: replay; else NULL */
    int32_t sender;         /* number of the node that sends it */
    int32_t n_forwards;
    forward_t *forwards;    /* what goes on at once when a sample was accepted */
} reception_t;

/* Two positions that have to be near each other at the start, each of a message heard. */
typedef struct {
    const reception_t *a, *b;
    int32_t first_a, first_b, count, reserved;
    double within;          /* greatest difference, unit of the values */
} apart_t;

/* Frames by which a drive with a protocol of its own is asked for a change of state, one after the
 * other; frames of other kinds may come between. */
typedef struct {
    const frame_t *frames;  /* `bus`: its number in the node */
    int32_t count, reached; /* reached: so many have come */
    int32_t request, reserved;  /* DRIVE_ENABLE, DRIVE_DISABLE, DRIVE_CLEAR */
} sequence_t;

typedef struct {
    struct node *node;
    reception_t *reception;
    delay_t *delay;
    int32_t first, count;   /* of the message's values */
    int64_t target;         /* into signals */
    double gain, offset;
    int64_t age;            /* signal that gets the time since the last arrival, s; -1: none */
    int64_t stop_ns;        /* silence that stops the node; 0: never */
    int64_t period;         /* ticks of the receiver */
    drive_t *drive;         /* between this and the plant; or NULL */
    int64_t max_age_ns;     /* drive: an older torque is not given, and feeds no watchdog; 0: any */
    int64_t q, dq;          /* of the plant, for the drive: signals */
    double *command;        /* (count,): drive: what was received */
    int64_t held, newest;   /* of this tick */
    int64_t last_newest;
    int64_t heard_ns;       /* when the newest arrived, by slots: staleness is deterministic */
    double *initial;        /* (count,): what it held at first, and holds again when that has gone */
    int32_t begun, reserved;
    int64_t link_age;       /* signal that gets the age of the sample held, s; -1: none */
    int64_t later;          /* 1: a row is written before this is passed (plants), else 0 */
    sequence_t *sequences;  /* of the drive, if it has a protocol of its own */
    int32_t n_sequences;
    uint32_t asked;         /* requests since the last pass, as commands_add packs them: of more than
                             * ten, none is lost that is DRIVE_DISABLE */
    int64_t requests;       /* those of this pass, which are in the journal */
} inlet_t;

typedef struct {
    struct node *node;
    const message_t *message;
    int32_t width, bus;
    const int64_t *sources; /* signals, one a value */
    double *values;         /* sent */
    int64_t every, hit_ticks;   /* hits between two messages; ticks of a hit */
    guard_t *guard;         /* or NULL */
    int32_t guarded, joints;    /* first value of the torque, how many */
    int64_t q, dq;          /* signals for the guard; -1: none */
    drive_t *drive;         /* measures what is sent; or NULL */
    int32_t measured_q, measured_dq;    /* first values of position, velocity; -1: none */
    history_t *history;     /* filled with what was sent: replay; else NULL */
    int64_t sent, saturated;    /* messages; those with values that did not fit */
    forward_t *forwards;    /* replay: what gateways have made of it, each behind what it is made of */
    int64_t n_forwards;
    int64_t foreign;        /* 1: commands a drive with a protocol of its own: all values are torques,
                             * and it is not sent while that drive is disabled */
} outlet_t;

/* A torque that stays inside the node: guarded in place, right after its component has computed it. */
typedef struct {
    struct node *node;
    guard_t *guard;
    int64_t tau, q, dq;     /* signals; q, dq -1: none */
} inside_t;

/* A table of the engine's that begins with the run, not with this life: of edges, weights and links. */
typedef struct {
    int64_t *row;
    int64_t period;         /* slots of a row */
} played_t;

typedef struct node {
    void *engine;           /* engine_t */
    int32_t (*run)(void *engine, int64_t ticks);
    double *signals;
    double **record;        /* &engine->record */
    int64_t *record_row;    /* &engine->row */

    int32_t clock, number;
    int64_t h_ns, phase_ns; /* length of a slot */
    double h;
    int64_t slot, first, slots; /* next, of this life, end of the run */
    int64_t start_ns;       /* CLOCK_MONOTONIC of t = 0; 0: not known: no START waits or was obeyed */
    int64_t asked_ns;       /* t = 0 of a START from outside; set before node_tell */
    int64_t nmt_ns;         /* t = 0 of the last START heard */
    int64_t now_ns;         /* of this slot */
    int64_t overrun_ns;     /* later than this is a fault */
    uint32_t told;          /* commands from outside: node_tell */
    int32_t quit;           /* from outside: stop at once */
    int32_t simulated, result;

    bus_t *buses;
    reception_t *receptions;
    inlet_t *inlets;
    outlet_t *outlets;
    inside_t *insides;
    peer_t *peers;
    faults_t *faults;       /* or NULL */
    int32_t n_buses, n_receptions, n_inlets, n_outlets, n_peers, n_insides;
    life_t life;

    const services_t *services; /* one a bus */
    int64_t heartbeat_slots, sync_slots;
    int64_t host_ns, host_due_ns;   /* period of host_heartbeat, and when the next one is due */
    uint32_t boots, sync_count;
    int64_t syncs_received, syncs_lost;
    int32_t sync_last;
    watchdog_t sync_watchdog;

    const apart_t *aparts;
    int32_t n_aparts;
    int32_t begun;          /* slots are being executed */
    int32_t ending;         /* its own ramp at the end of the run */
    int32_t refusals;       /* how often START or ARM was refused, and why last: WHY_... */
    uint32_t refused;
    uint32_t beats;         /* heartbeats sent */
    int32_t alarm;          /* ALARM_RAISED from outside: emergency stop */
    int32_t alarms;         /* ESTOP frames still to be sent */
    int64_t alarm_ns;       /* when the next one is due */

    journal_t *journal, *heard;  /* heard: NULL in a replay, which reads one */
    int64_t inlet_offset, outlet_offset, signals_offset;    /* into a row */
    const char *replayed;   /* CLOCK_REPLAY: rows of the recording */
    int64_t replayed_rows, row_size, replay_row;

    histogram_t late;
    int64_t missed, spin_ns;
    int64_t done_ns;        /* when the last slot was done */
    int64_t send_ns;        /* spent encoding and sending in this slot */
    int64_t stopping;       /* STOP has come: at the end of the ramp the node ends */
    int64_t unknown;        /* frames nobody here listens to */
    frame_t *pending;       /* a bus: the next frame, where it comes too early for this slot */
    int32_t *has_pending;
    played_t *played;
    int64_t n_played;
    int64_t gateway;        /* 1: it forwards, and wakes for what comes, else 0 */
    int64_t patience_ns, lead_ns;   /* a START whose time has passed waits so long for what is missing */
    int32_t (*joined)(int64_t slot);    /* and its life begins lead_ns later, after this; 0: well */
    epoch_t epoch;
    const frame_t *disabling, *enabling;    /* of all drives with protocols of their own that it
                             * commands; enabling: each cleared first. `bus`: its number in the node */
    int32_t n_disabling, n_enabling;
    int64_t disabled;       /* 1: it has disabled them, and sends them no torque */
    int64_t disable_ns;     /* when it does so again */
} node_t;

/* Begins every row of the journal; then inlets, outlets, signals. */
typedef struct {
    int64_t slot, deadline_ns, woke_ns, received_ns, send_ns, done_ns; /* send: a duration */
    int32_t state;
    uint32_t commands;      /* of this slot: heard, then told; see safety.h */
    uint32_t now, reasons;
    uint32_t guard, flags;
    double scale;
} row_t;

typedef struct { int64_t held, newest, age_ns, transit_ns, requests; } inlet_row_t;

/* Begins every row of the journal of what was heard: a sample of the message that is number `message`
 * among the receptions, as its receiver numbered it; then its values, room for the widest message. */
typedef struct { int64_t sequence, arrival_ns; int32_t message; uint32_t status; } heard_t;

/* Whether a message says in which state its sender is: a status of 4 bits (classic CAN) does not. */
static inline int32_t tells_life(const message_t *m)
{
    return m->status >= 0 && m->header[m->status].scale == 1.0;
}

/* The gates: `pass` of engine gates. inlet.c, node.c */
API int32_t inlet_pass(void *context, int64_t tick, double *signals);
API int32_t outlet_pass(void *context, int64_t tick, double *signals);
API int32_t inside_pass(void *context, int64_t tick, double *signals);

/* A sample of r that was accepted, with r's values, into the journal of what was heard. heard.c */
void node_heard(node_t *n, const reception_t *r, int64_t sequence, int64_t arrival_ns, uint32_t status);
/* Frames that have arrived by limit_ns (relative): checked, decoded, put into delay lines. hear.c */
void node_hear(node_t *n, int64_t limit_ns);
/* A command from another thread: none is lost, whoever else gives one. node.c */
API void node_tell(node_t *n, int32_t command);
/* A message of an outlet, with the values it has; its time stamp is the nominal time of this sample,
 * so receivers know how old it is, and which one, however late the node was. node.c */
void node_say(outlet_t *o, int64_t sequence, int64_t now_ns);
/* 0, or why it was not handed over: of bus_send. */
int32_t node_send(node_t *n, int32_t bus, frame_t *frame, int64_t now_ns);
/* A sample or preview of r that has been accepted, as the messages made of it, with the number, time
 * and status of its first sender. node_pass: NMT or EPOCH (its place in services_t) from one bus, on all
 * others. node_rest: until
 * the deadline (CLOCK_MONOTONIC); a gateway hears, and forwards, meanwhile. forward.c */
void node_forward(node_t *n, const reception_t *r, const header_t *header, const frame_t *came);
void node_pass(node_t *n, size_t service, const double *values, header_t header, const frame_t *came);
void forward_remember(forward_t *f, int64_t sample);
int64_t node_rest(node_t *n, int64_t deadline_ns);
/* What a node says besides its outlets; the preview only in messages that tell it from samples.
 * ESTOP: the node that raised it repeats it every 10 ms until RESET; one that heard it passes it on
 * ten times, on all its buses (a gateway the first time at once). service.c */
void node_heartbeat(node_t *n, int64_t now_ns);
/* One of them on one bus; m NULL: the bus does not have it. */
void node_service(node_t *n, int32_t bus, const message_t *m, const double *values, header_t header,
                  int64_t now_ns);
/* CANopen's heartbeat (one byte, the state as CiA 301 numbers it), when it is due. */
void node_host(node_t *n, int64_t now_ns);
void node_host_sync(node_t *n, int64_t now_ns);
void node_preview(node_t *n, int64_t now_ns);
void node_sync(node_t *n, int64_t now_ns);
void node_alarm(node_t *n, int64_t now_ns);
void node_estop(node_t *n, int64_t now_ns);
int32_t node_is_estop(const node_t *n, const frame_t *frame);
/* EPOCH on all buses, of this node's run; answer: if a peer waits for a start, at most one in 100 ms.
 * heard: of another, whose run a waiting node then knows. node_origin: t = 0 of a START that came at
 * arrival_ns: as the EPOCH of the second before says, else lead_ns later. node_run_of: the number of the
 * run with this t = 0; told: by who owns this process, not on a bus. epoch.c */
void node_epoch(node_t *n);
void node_epoch_answer(node_t *n);
void node_epoch_heard(node_t *n, const frame_t *frame);
API int64_t node_origin(const node_t *n, int64_t arrival_ns, int64_t lead_ns);
int32_t node_run_of(const node_t *n, int64_t start_ns, int32_t told);
/* Drives with protocols of their own, behind the torques of a slot. In FAULT (after the ramp) they are
 * disabled, and again every 100 ms, as a frame may get lost and a supervisor may enable them; ACTIVE
 * again, cleared and enabled. Returns ROW_DISABLED, ROW_ENABLED or 0. node_disable: now. sequence.c */
uint32_t node_drives(node_t *n, int64_t now_ns);
void node_disable(node_t *n, int64_t now_ns);
/* Whether a frame belongs to a sequence of an emulated drive, which follows it. sequence.c */
int32_t node_asked(node_t *n, const frame_t *frame);
/* Before the start, on the wall clock: heartbeats and previews, until START is obeyed. START is held
 * until 100 ms before start_ns and obeyed then, or in the 80 ms after it, as soon as required peers
 * are there, messages that are `awaited` were heard, drives have watchdogs and positions are near each
 * other; else it is refused: `refusals`, `refused`. A START whose time has passed (of a node that joins
 * a run) waits for `patience_ns`. A node that `follows` joins by itself a run whose EPOCH it hears, until
 * it is told to STOP. ARM is refused likewise. A rehearsal arms itself; where real drives
 * are meant, ARM has to come first. LIVE_FINISHED: it is ACTIVE. start.c */
int32_t node_wait(node_t *n);
API int32_t node_unheard(const node_t *n, int32_t i);   /* message i is awaited and was not heard */
API int32_t node_absent(const node_t *n, int32_t i, int64_t now);   /* peer i is required, not there */
/* The ends of a run: a component has failed (its torque is let down in the life cycle's ramp); `quit`;
 * the last slot is done. All leave zero torque on the bus. end.c */
void node_let_down(node_t *n);
void node_farewell(node_t *n);
int32_t node_end(node_t *n);

/* One slot, with what has arrived by limit_ns (relative). Returns the engine's result. */
int32_t node_slot(node_t *n, int64_t limit_ns, int64_t woke_ns, uint32_t flags);

/* Wall clock: from configured to finished. Waits for COMMAND_START with start_ns set (or NMT start),
 * then slot by slot until the end, a stop, or `quit`. Where real drives are meant, the life cycle's
 * ramp ends with the last slot; a rehearsal, comparable to its end, sends zero torque after it. */
API int32_t node_live(node_t *n);

/* At the first slot: emulated drives on and enabled, tables at their rows. node_live does it. */
API void node_enable(node_t *n, int64_t now_ns);
/* Simulated clock: all nodes to the end, the next deadline first; frames take frame_ns on their bus,
 * one after the other, and are forwarded when they arrive. `routes`: for each node and bus the number of the
 * shared network, or -1; `busy`: until when each network is busy. Ends before `until_ns`; the next call continues from there. */
API int32_t nodes_simulate(node_t **nodes, int32_t n_nodes, int64_t (*frame_time)(const frame_t *, double, double),
                           const double *bitrates, int64_t *busy, const int32_t *routes, int32_t n_routes,
                           int64_t until_ns);

API int32_t node_replay(node_t *n);  /* along its recording, from what it held: the engine's result */
/* Slots of one node on the simulated clock, slot i with what has arrived by limits[i]: of a bus log. */
API int32_t node_follow(node_t *n, const int64_t *limits, int64_t count);

#endif
