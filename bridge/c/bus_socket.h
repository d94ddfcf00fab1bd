/* bus_socket.h: the two calls of bus.c that go to the kernel. Private to the bus. */
#ifndef BRIDGE_BUS_SOCKET_H
#define BRIDGE_BUS_SOCKET_H

#include "bus.h"

/* 1: *frame has flags, id, length, data and t_ns; 0: none. Errors of the socket are in *bus. */
int socket_next(bus_t *bus, frame_t *frame);
/* 0, or an errno */
int32_t socket_send(const bus_t *bus, const frame_t *frame);

#endif
