/* core.h - the simulated CAN bus (bus.h) as the core of an FMU (lsbus.h): each terminal is a node.
 *
 * Memory is allocated with the instance, none later.
 */
#ifndef CORE_H
#define CORE_H

#include "bus.h"
#include "bus_config.h" /* N_NODES, BIT_PS, DATA_BIT_PS, BITRATE, DATA_BITRATE, WITH_FD, TOKEN */
#include "lsbus.h"

enum { QUEUE = 64, EVENTS = 1024 + 8 * N_NODES };
enum { NOTIFICATIONS = 0 /* value reference, a constant */, N_PORTS = N_NODES };

/* A frame that waits or is being sent. */
typedef struct {
    int64_t request;
    uint32_t id;
    int32_t node;
} bus_waiting_t;

struct fmu {
    LSBUS_MEMBERS(N_NODES);
    bool discards[N_NODES], off[N_NODES]; /* by Configuration and Status of a node */
    bus_waiting_t waiting[N_NODES * QUEUE], contenders[N_NODES];
    int32_t n_waiting, n_contenders;
    int64_t requests; /* so far */
    int64_t started;  /* of the transmission of the contenders, ps */
    bus_event_t events[EVENTS];
    can_frame_t frames[EVENTS];
    bus_t *bus;
    uint8_t *memory, *saved; /* of the bus, 16-byte aligned; a copy of it */
    size_t size;
};

#endif
