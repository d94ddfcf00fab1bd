/* node.h: the structs of a node, for any clock. The functions are in slot.h and the other headers.
 *
 * All times named *_ns are relative to the start of the run, except start_ns and deadlines of pace.h.
 */
#ifndef BRIDGE_NODE_H
#define BRIDGE_NODE_H

#include <stddef.h>

#include "bus.h"
#include "commanded.h"
#include "epoch.h"
#include "faults.h"
#include "gates.h"
#include "journal.h"
#include "life_cycle.h"
#include "pace.h"
#include "rows.h"
#include "watchdog.h"

enum { CLOCK_WALL = 1, CLOCK_SIMULATED = 2, CLOCK_REPLAY = 3 };
/* What node_live returns; positive: of engine_run. */
enum {
    LIVE_FINISHED = 0,
    LIVE_STOPPED = -1,
    LIVE_NEVER_STARTED = -2,
    LIVE_FAULT = -3 /* came to the end in FAULT */,
    LIVE_NOT_JOINED = -4
};
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
    const message_t **peers; /* heartbeats of the node's peers, one a peer; NULL in it: not here */
    const message_t *host_heartbeat, *host_sync; /* CANopen's, for drives that this node commands */
    int64_t host_sync_slots;                     /* slots between two of them */
} services_t;

/* Emergency stop of this node: none, to be obeyed, its own until RESET. */
enum { ALARM_NONE, ALARM_RAISED, ALARM_OURS };

/* Two positions that must be close to each other at the start, each from a received message. */
typedef struct {
    const reception_t *a, *b;
    int32_t first_a, first_b, count, reserved;
    double within; /* greatest difference, unit of the values */
} apart_t;

/* A table of the engine's that begins with the run, not with this life: of edges, weights and links. */
typedef struct {
    int64_t *row;
    int64_t period; /* slots of a row */
} played_t;

typedef struct node {
    /* ---- what it is: set before it lives, and not changed by C ---- */
    int32_t clock, number;
    int32_t simulated; /* 1: the node is part of a simulation, and its messages are marked as simulated */
    uint32_t boots;
    double h;               /* length of a slot, s */
    int64_t h_ns, phase_ns; /* the same; when slot 0 begins */
    int64_t slots;          /* of the run */
    int64_t overrun_ns;     /* later than this is a fault */
    int64_t spin_ns;        /* the end of a wait that is spent awake */
    int64_t heartbeat_slots, sync_slots;
    int64_t host_ns;                 /* period of host_heartbeat */
    int64_t feed_ns;                 /* time between two frames that feed drives before the first slot */
    int64_t gateway;                 /* 1: it forwards, and wakes for what comes, else 0 */
    int64_t patience_ns, lead_ns;    /* maximum wait of a START whose time has passed for missing inputs */
    int32_t (*joined)(int64_t slot); /* and its life begins lead_ns later, after this; 0: well */
    int64_t inlet_offset, outlet_offset, signals_offset; /* into a row */
    const char *replayed;                                /* CLOCK_REPLAY: rows of the recording */
    int64_t replayed_rows, row_size;

    /* ---- its parts, each with a state of its own ---- */
    void *engine; /* engine_t */
    int32_t (*run)(void *engine, int64_t ticks);
    double *signals;
    double **record;     /* &engine->record */
    int64_t *record_row; /* &engine->row */
    bus_t *buses;
    reception_t *receptions;
    inlet_t *inlets;
    outlet_t *outlets;
    inside_t *insides;
    peer_t *peers;
    faults_t *faults;           /* or NULL */
    const services_t *services; /* one a bus */
    const apart_t *aparts;
    commanded_t *commanded; /* drives with protocols of their own that it commands */
    motor_t *motors;        /* emulated drives of vendors, each behind an inlet */
    played_t *played;
    journal_t *journal, *heard; /* received samples: NULL in a replay, which reads them */
    int32_t n_buses, n_receptions, n_inlets, n_outlets, n_insides, n_peers, n_aparts, n_commanded;
    int64_t n_motors, n_played;

    /* ---- the run ---- */
    life_t life;
    epoch_t epoch;
    int64_t slot, first; /* the next one; the first of this life */
    int64_t start_ns;    /* CLOCK_MONOTONIC of t = 0; 0: not known: no START waits or was obeyed */
    int64_t nmt_ns;      /* t = 0 of the last START received */
    int64_t now_ns;      /* of this slot */
    int64_t done_ns;     /* when the last slot was done */
    int64_t send_ns;     /* spent encoding and sending in this slot */
    int64_t replay_row;
    int32_t begun;    /* slots are being executed */
    int32_t ending;   /* its own ramp at the end of the run */
    int32_t result;   /* of engine_run */
    int32_t deferred; /* 1: a START waits for these drives to be ready */
    int64_t stopping; /* STOP has come: at the end of the ramp the node ends */
    frame_t *pending; /* a bus: the next frame, where it comes too early for this slot */
    int32_t *has_pending;
    int64_t host_due_ns;        /* when the next host_heartbeat is due */
    int64_t host_sync_ns;       /* when the periods of host_sync were looked at before the first slot */
    int64_t fed_ns, disable_ns; /* when drives were fed before the first slot; when they are disabled again */
    uint32_t sync_count;        /* of what it sends */
    int32_t sync_last;          /* of what it receives */
    watchdog_t sync_watchdog;
    int32_t alarms;   /* ESTOP frames still to be sent */
    int64_t alarm_ns; /* when the next one is due */

    /* ---- from outside, at any time ---- */
    int64_t asked_ns; /* t = 0 of a START; set before node_tell */
    uint32_t told;    /* commands: node_tell */
    int32_t quit;     /* stop immediately */
    int32_t alarm;    /* ALARM_RAISED: emergency stop */

    /* ---- counters ---- */
    uint32_t refused; /* why START or ARM was refused last: WHY_... */
    int32_t refusals; /* and how often */
    uint32_t beats;   /* heartbeats sent */
    int64_t syncs_received, syncs_lost;
    int64_t missed;
    int64_t unknown;     /* frames to which this node does not subscribe */
    int64_t late_starts; /* STARTs that came while slots were executed */
    int64_t damaged;     /* frames of services that could not be read */
    histogram_t late;
    drive_events_t drive_events;
} node_t;

/* Whether t = 0 is known. */
static inline int32_t node_started(const node_t *n) { return n->clock != CLOCK_WALL || n->start_ns != 0; }

#endif
