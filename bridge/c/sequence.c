/* sequence.c: the response of an emulated drive to the frames of its protocol; see sequence.h. */
#include "sequence.h"

#include <string.h>

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
