/* hostile.h: frames of a peer that knows the format of a message; kinds FORGE to FLOOD of faults.h. */
#ifndef BRIDGE_HOSTILE_H
#define BRIDGE_HOSTILE_H

#include "faults.h"

/* SplitMix64: Steele, Lea, Flood, "Fast splittable pseudorandom number generators", 2014. */
static inline uint64_t faults_next(uint64_t *state)
{
    uint64_t z = *state += 0x9E3779B97F4A7C15u;
    z = (z ^ z >> 30) * 0xBF58476D1CE4E5B9u;
    z = (z ^ z >> 27) * 0x94D049BB133111EBu;
    return z ^ z >> 31;
}

/* A number of 64 random bits as one in [0, 1). */
static inline double faults_share(uint64_t z) { return (double)(z >> 11) * (1.0 / 9007199254740992.0); }

static inline double faults_unit(uint64_t *state) { return faults_share(faults_next(state)); }

/* Makes the frame anew, its CRC right, its counter so far ahead: FORGE adds to its values, ABSURD
 * replaces them, FLOOD leaves them. 0: it is not valid itself, and is left alone. */
int32_t hostile_remake(const fault_t *r, frame_t *frame, uint32_t ahead, uint64_t *draws);
/* How many frames a flood adds to the one that came at t: until the next one, if that takes as long. */
int64_t hostile_flood(fault_t *r, int64_t t);
/* REPLAY: records a frame; the next one that is sent again, NULL: none was recorded. */
void hostile_remember(fault_t *r, const frame_t *frame);
const frame_t *hostile_again(fault_t *r);

#endif
