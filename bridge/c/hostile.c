/* hostile.c: see hostile.h */
#include "hostile.h"

#include <string.h>

int32_t hostile_remake(const fault_t *r, frame_t *frame, uint32_t ahead, uint64_t *draws)
{
    header_t header;
    const message_t *m = r->message;
    const frame_t was = *frame;
    memset(&header, 0, sizeof header);
    if (!m || message_decode(m, frame, r->values, &header) != DECODE_OK) return 0;
    for (int32_t i = 0; i < m->n_fields && r->kind != FAULT_FLOOD; i++) {
        const double x = r->a + (r->b - r->a) * faults_unit(draws);
        r->values[i] = r->kind == FAULT_FORGE ? r->values[i] + x : i % 2 ? -x : x;
    }
    header.counter += ahead;
    message_encode(m, r->values, &header, frame);
    frame->t_ns = was.t_ns;
    frame->bus = was.bus;
    return 1;
}

int64_t hostile_flood(fault_t *r, int64_t t)
{
    const int64_t apart = (int64_t)(r->a * 1e9), passed = r->last_ns > 0 ? t - r->last_ns : 0;
    const int64_t n = apart > 0 ? passed / apart : 0;
    r->last_ns = t;
    return n < FAULT_MOST ? n : FAULT_MOST;
}

void hostile_remember(fault_t *r, const frame_t *frame) { r->store[r->stored++ % r->count] = *frame; }

const frame_t *hostile_again(fault_t *r)
{
    const int64_t there = r->stored < r->count ? r->stored : r->count;
    return there > 0 ? r->store + (r->stored - there + r->taken++ % there) % r->count : NULL;
}
