/* sequence.c: drives with their own protocols: disabled and enabled by the node that commands them, and
 * the response of an emulated drive to such frames; see sequence.h. */
#include "sequence.h"

#include <string.h>

#include "send.h"

enum { AGAIN_NS = 100000000 };

/* ---- the node that commands drives ---- */

static void send_frames(node_t *n, const frame_t *frames, int32_t count, int64_t now_ns)
{
    for (int32_t i = 0; i < count; i++) {
        frame_t frame = frames[i];
        node_send(n, frame.bus, &frame, now_ns);
    }
}

void node_disable(node_t *n, int64_t now_ns)
{
    n->disabled = 1;
    n->disable_ns = now_ns + AGAIN_NS;
    if (n->clock != CLOCK_REPLAY) send_frames(n, n->disabling, n->n_disabling, now_ns);
}

uint32_t node_drives(node_t *n, int64_t now_ns)
{
    const int32_t replay = n->clock == CLOCK_REPLAY;
    if (n->n_disabling == 0) return 0;
    if (n->life.state == LIFE_FAULT && (!n->disabled || now_ns >= n->disable_ns)) {
        node_disable(n, now_ns);
        return replay ? 0 : ROW_DISABLED;
    }
    if (n->life.state == LIFE_ACTIVE && n->disabled) {
        n->disabled = 0;
        if (replay) return 0;
        send_frames(n, n->enabling, n->n_enabling, now_ns);
        return ROW_ENABLED;
    }
    return 0;
}

/* ---- an emulated drive ---- */

static int32_t same_frame(const frame_t *a, const frame_t *b)
{
    return a->id == b->id && a->bus == b->bus && !((a->flags ^ b->flags) & FRAME_FORMAT) &&
           a->length == b->length && !memcmp(a->data, b->data, a->length);
}

/* Whether it is the next frame of this sequence; the last one is the request. */
static int32_t further(sequence_t *s, const frame_t *frame, uint32_t *asked)
{
    if (!same_frame(s->frames + s->reached, frame)) return 0;
    if (++s->reached == s->count) {
        s->reached = 0;
        *asked = commands_add(*asked, s->request);
    }
    return 1;
}

int32_t node_asked(node_t *n, const frame_t *frame)
{
    int32_t found = 0;
    for (int32_t i = 0; i < n->n_inlets; i++) {
        inlet_t *in = n->inlets + i;
        for (int32_t k = 0; k < in->n_sequences; k++)
            found |= further(in->sequences + k, frame, &in->asked);
    }
    return found;
}
