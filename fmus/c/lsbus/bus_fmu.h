/* bus_fmu.h - the simulated CAN bus (bus.h) as an FMU: operations of FMI-LS-BUS 1.0 in and out.
 *
 * Each node is a terminal with four variables (see `variable`). What arrives in Rx_Data is carried
 * out by `settle`; what the bus tells a node is in its `tx` until its Tx_Clock ticks at the time
 * that `schedule` has announced. Memory is allocated with the instance, none later.
 */
#ifndef BUS_FMU_H
#define BUS_FMU_H

#include "bus.h"
#include "bus_config.h" /* N_NODES, BIT_PS, DATA_BIT_PS, BITRATE, DATA_BITRATE, WITH_FD, TOKEN */
#include "fmi3.h"

enum { QUEUE = 64, ROOM = 1 << 15, EVENTS = 1024 + 8 * N_NODES };
/* Value references: 4 * node + 1 and the three after it; NOTIFICATIONS is a constant,
 * TIME the independent variable. */
enum { NOTIFICATIONS = 0, TX_CLOCK = 1, RX_CLOCK, TX_DATA, RX_DATA, TIME = 4 * N_NODES + 1 };
enum { INSTANTIATED = 1, INITIALIZATION = 2, EVENT = 4, STEPPING = 8, TERMINATED = 16 };

#define NEVER INT64_MAX

typedef struct {
    uint8_t rx[ROOM], tx[ROOM]; /* operations from the node, and for it */
    size_t n_rx, n_tx;
    int64_t tick;               /* ps, of its Tx_Clock; NEVER */
    bool rx_on, tx_on;          /* its clocks, in this instant */
    bool changed;               /* the importer has not asked for `tick` yet */
    bool discards, off;         /* by its Configuration and its Status */
} bus_port_t;

/* A frame that waits or is being sent. */
typedef struct {
    int64_t request;
    uint32_t id;
    int32_t node;
} bus_waiting_t;

typedef struct {
    fmi3LogMessageCallback log;
    fmi3InstanceEnvironment environment;
    unsigned mode;
    int64_t now;                /* ps */
    bus_port_t ports[N_NODES];
    bus_waiting_t waiting[N_NODES * QUEUE], contenders[N_NODES];
    int32_t n_waiting, n_contenders;
    int64_t requests;           /* so far */
    int64_t started;            /* of the transmission of the contenders, ps */
    bus_event_t events[EVENTS];
    can_frame_t frames[EVENTS];
    bus_t *bus;
    uint8_t *memory, *saved;    /* of the bus, 16-byte aligned; a copy of it */
    size_t size;
    char message[256];
} bus_fmu_t;

/* Log a sentence and return fmi3Error. */
fmi3Status bus_refuse(bus_fmu_t *x, const char *format, ...);
/* Bytes of memory of a bus. */
size_t bus_room(void);
/* A bus at time 0, in the memory of the instance. */
void bus_begin(bus_fmu_t *x);
/* Go on to `until` (ps). */
fmi3Status bus_go(bus_fmu_t *x, int64_t until);
/* Carry out what nodes have sent in this instant. */
fmi3Status bus_settle(bus_fmu_t *x);
/* Find out when each Tx_Clock ticks next. */
void bus_schedule(bus_fmu_t *x);

#endif
