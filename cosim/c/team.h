/* team.h: threads that share the operations of a segment.
 *
 * The blocks of a segment do not depend on each other: whoever executes them, in whatever order, the
 * signals are the same. Each thread has a part of them, the same in every tick, so that what they
 * need stays in its cache; who is done takes chunks of the others. The chunks of a part are handed
 * out by one atomic number, the ticket: generation, number of chunks, next chunk. A thread that comes
 * late finds fewer chunks, and no thread waits for one that has none. The caller starts the threads:
 * each calls engine_work while engine_run runs.
 */
#ifndef COSIM_TEAM_H
#define COSIM_TEAM_H

#include <stdint.h>

#if defined(_WIN32)
#include <windows.h>
#define YIELD() SwitchToThread()
#else
#include <sched.h>
#define YIELD() sched_yield()
#endif

#if defined(__GNUC__)
#define LOAD(place) __atomic_load_n(place, __ATOMIC_ACQUIRE)
#define STORE(place, value) __atomic_store_n(place, value, __ATOMIC_RELEASE)
#define ADD(place, value) __atomic_fetch_add(place, value, __ATOMIC_ACQ_REL)
#define HAS_THREADS 1
#else
#define LOAD(place) (*(place))
#define STORE(place, value) (*(place) = (value))
#define ADD(place, value) ((*(place) += (value)) - (value))
#define HAS_THREADS 0   /* a compiler whose atomic operations are not known here: one thread */
#endif

enum { CHUNK_BITS = 20, CHUNKS_A_THREAD = 8, LEAST_BLOCKS = 4, SPINS = 2000 };

static inline uint64_t ticket_of(uint64_t generation, uint64_t chunks)
{
    return generation << 2 * CHUNK_BITS | chunks << CHUNK_BITS;
}

static inline uint64_t next_of(uint64_t ticket) { return ticket & ((1u << CHUNK_BITS) - 1); }

static inline uint64_t chunks_of(uint64_t ticket)
{
    return ticket >> CHUNK_BITS & ((1u << CHUNK_BITS) - 1);
}

/* A moment of waiting: first on this processor, then others may have it. */
static inline void wait_a_moment(int *spins)
{
    if (++*spins < SPINS) {
#if defined(__x86_64__) || defined(__i386__)
        __builtin_ia32_pause();
#endif
        return;
    }
    YIELD();
}

#endif
