/* bus_socket.h: frames to and from a raw AF_CAN socket: the calls of bus.c that go to the kernel. */
#ifndef BRIDGE_BUS_SOCKET_H
#define BRIDGE_BUS_SOCKET_H

#include "bus.h"

/* What a BUS_SOCKET needs of its socket: arrival stamps and the count of lost frames. 0 or errno. */
API int32_t bus_prepare(int32_t fd);
/* 1: *frame has flags, id, length, data and t_ns; 0: none. Errors of the socket are in *bus. */
int socket_next(bus_t *bus, frame_t *frame);
/* 0, or an errno */
int32_t socket_send(const bus_t *bus, const frame_t *frame);

#endif
