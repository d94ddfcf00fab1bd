/* vendor_kind.h: what vendor.c needs of each vendor, and what these need of it. */
#ifndef BRIDGE_VENDOR_KIND_H
#define BRIDGE_VENDOR_KIND_H

#include <string.h>

#include "vendor.h"

typedef struct {
    void (*boot)(vendor_t *v, int64_t t_ns);                      /* power-up is over */
    void (*bring_up)(vendor_t *v);                                /* enabled */
    int32_t (*take)(vendor_t *v, const frame_t *f, int64_t t_ns); /* as vendor_take */
    int64_t (*due)(const vendor_t *v);                            /* next event of its own, INT64_MAX: none */
    void (*event)(vendor_t *v, int64_t t_ns);
    void (*mark)(const vendor_t *v, int32_t part, frame_t *f); /* a feedback frame, at its sending */
    void (*beat)(vendor_t *v, int64_t t_ns);                   /* its heartbeat is due */
    void (*trip)(vendor_t *v, uint32_t code, int64_t t_ns);
    uint32_t hot[2]; /* codes of over-temperature: of the electronics, of the motor */
} vendor_kind_t;

/* A data frame of 11-bit identifiers. */
static inline int32_t vendor_plain(const frame_t *f)
{
    return !(f->flags & (FRAME_REMOTE | FRAME_EXTENDED | FRAME_ERROR));
}

static inline uint32_t vendor_u32(const uint8_t *d)
{
    return (uint32_t)d[0] | (uint32_t)d[1] << 8 | (uint32_t)d[2] << 16 | (uint32_t)d[3] << 24;
}

static inline void vendor_put32(uint8_t *d, uint32_t x)
{
    for (int32_t k = 0; k < 4; k++) d[k] = (uint8_t)(x >> 8 * k);
}

static inline float vendor_float(const uint8_t *d)
{
    const uint32_t raw = vendor_u32(d);
    float x;
    memcpy(&x, &raw, sizeof x);
    return x;
}

static inline void vendor_put_float(uint8_t *d, double x)
{
    const float value = (float)x;
    uint32_t raw;
    memcpy(&raw, &value, sizeof raw);
    vendor_put32(d, raw);
}

#endif
