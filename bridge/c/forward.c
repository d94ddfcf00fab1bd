/* forward.c: messages that a gateway makes from received messages; see forward.h. */
#include "forward.h"

#include <string.h>

#include "send.h"

static void encode(forward_t *f, const double *values, const header_t *header, frame_t *frame)
{
    header_t sent = *header; /* encoding counts in it what saturates */
    memset(frame, 0, sizeof *frame);
    for (int32_t k = 0; k < f->width; k++) f->values[k] = values[f->sources[k]];
    message_encode(f->message, f->values, &sent, frame);
}

/* State of a sender whose messages do not contain it: that of its heartbeat, otherwise ACTIVE. */
static uint32_t life_of(const node_t *n, const reception_t *r)
{
    for (int32_t i = 0; i < n->n_peers; i++)
        if ((int32_t)n->peers[i].number == r->sender && n->peers[i].state > LIFE_INACTIVE)
            return (uint32_t)n->peers[i].state;
    return LIFE_ACTIVE;
}

static uint32_t status_of(const node_t *n, const reception_t *r, uint32_t status)
{
    if (tells_life(r->message)) return status;
    if (r->message->status < 0 && n->simulated) status |= STATUS_SIMULATED;
    return (status & ~(uint32_t)STATUS_LIFE) | life_of(n, r);
}

void node_forward(node_t *n, const reception_t *r, const header_t *header, const frame_t *came)
{
    header_t sent = *header;
    if (r->n_forwards > 0) sent.status = status_of(n, r, header->status);
    for (int32_t i = 0; i < r->n_forwards; i++) {
        forward_t *f = r->forwards + i;
        frame_t frame;
        encode(f, r->values, &sent, &frame);
        const int32_t failed = node_send(n, f->bus, &frame, came->t_ns - n->start_ns) != 0;
        if (!n->begun) continue; /* previews and the like are not counted */
        f->failed += failed;
        f->sent += !failed;
        if (n->clock == CLOCK_WALL) histogram_add(&f->transit, pace_now() - came->t_ns);
    }
}

void node_pass(node_t *n, size_t service, const double *values, header_t header, const frame_t *came)
{
    for (int32_t b = 0; b < n->n_buses; b++) {
        const message_t *m;
        memcpy(&m, (const char *)(n->services + b) + service, sizeof m);
        if (b != came->bus) node_service(n, b, m, values, header, came->t_ns - n->start_ns);
    }
}

/* What receivers behind the gateway got of a sample: through both codecs. */
void forward_remember(forward_t *f, int64_t sample)
{
    frame_t frame;
    header_t header;
    memset(&header, 0, sizeof header);
    if (f->of->there[sample] != SAMPLE_THERE) return;
    encode(f, f->of->values + sample * f->of->width, &header, &frame);
    if (message_decode(f->message, &frame, f->to->values + sample * f->to->width, &header) == DECODE_OK)
        f->to->there[sample] = SAMPLE_THERE;
}
