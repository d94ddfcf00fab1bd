/* frame.c: see frame.h */
#include "frame.h"

#include <unistd.h>

/* Wakes a thread that sleeps on a descriptor; a full descriptor was already signaled. */
static void ring_bell(const ring_t *ring)
{
    const uint64_t one = 1;

    if (ring->bell > 0 && write(ring->bell, &one, sizeof one) < 0) return;
}

int32_t ring_put(ring_t *ring, const frame_t *frame)
{
    uint64_t head = __atomic_load_n(&ring->head, __ATOMIC_RELAXED);
    uint64_t tail = __atomic_load_n(&ring->tail, __ATOMIC_ACQUIRE);
    frame_t *place;

    if (head - tail >= (uint64_t)ring->capacity) {
        __atomic_store_n(&ring->dropped, ring->dropped + 1, __ATOMIC_RELAXED);
        return 0;
    }
    place = &ring->frames[head & (uint64_t)(ring->capacity - 1)];
    *place = *frame;
    place->sequence = (uint32_t)head;
    __atomic_store_n(&ring->head, head + 1, __ATOMIC_RELEASE);
    ring_bell(ring);
    return 1;
}

int32_t ring_get(ring_t *ring, frame_t *frame)
{
    uint64_t tail = __atomic_load_n(&ring->tail, __ATOMIC_RELAXED);
    uint64_t head = __atomic_load_n(&ring->head, __ATOMIC_ACQUIRE);

    if (head == tail) return 0;
    *frame = ring->frames[tail & (uint64_t)(ring->capacity - 1)];
    __atomic_store_n(&ring->tail, tail + 1, __ATOMIC_RELEASE);
    return 1;
}
