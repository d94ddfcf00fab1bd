/* send.c: a frame handed to a bus; see send.h. */
#include "send.h"

#include <string.h>

int32_t node_send(node_t *n, int32_t bus, frame_t *frame, int64_t now_ns)
{
    bus_t *b = n->buses + bus;
    frame->bus = (uint8_t)bus;
    if (n->clock != CLOCK_WALL) frame->t_ns = now_ns;
    return bus_send(b, frame);
}

void node_service(node_t *n, int32_t bus, const message_t *m, const double *values, header_t header,
                  int64_t now_ns)
{
    frame_t frame;
    if (!m) return;
    memset(&frame, 0, sizeof frame);
    message_encode(m, values, &header, &frame);
    node_send(n, bus, &frame, now_ns);
}
