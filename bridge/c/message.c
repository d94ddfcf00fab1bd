/* message.c: see message.h. Bytes are read and written one by one, in shifts that compilers join:
 * the result does not depend on the machine's byte order. */
#include "message.h"

#include <string.h>

/* ---- bits ---- */

static uint64_t mask_of(int32_t length) { return length >= 64 ? ~(uint64_t)0 : ((uint64_t)1 << length) - 1; }

/* Bit `at` of the data, counted as the byte order does: Intel from the least significant bit of byte
 * 0 upwards, Motorola from the most significant bit of byte 0 downwards. */
static uint64_t get_intel(const uint8_t *data, int32_t start, int32_t length)
{
    const uint8_t *p = data + start / 8;
    int32_t have = 8 - start % 8;
    uint64_t raw = *p >> (start % 8);
    for (; have < length; have += 8) raw |= (uint64_t)*++p << have;
    return raw & mask_of(length);
}

static void put_intel(uint8_t *data, int32_t start, int32_t length, uint64_t raw)
{
    uint8_t *p = data + start / 8;
    int32_t shift = start % 8, left = length;
    while (left > 0) {
        uint8_t mask = (uint8_t)(mask_of(left) << shift);
        *p = (uint8_t)((*p & ~mask) | ((raw << shift) & mask));
        raw >>= 8 - shift;
        left -= 8 - shift;
        shift = 0;
        p++;
    }
}

static uint64_t get_motorola(const uint8_t *data, int32_t start, int32_t length)
{
    const uint8_t *p = data + start / 8;
    int32_t have = start % 8 + 1;
    uint64_t raw = *p & mask_of(have);
    if (have >= length) return raw >> (have - length);
    for (; have + 8 <= length; have += 8) raw = raw << 8 | *++p;
    if (have < length) raw = raw << (length - have) | *++p >> (8 - (length - have));
    return raw;
}

static void put_motorola(uint8_t *data, int32_t start, int32_t length, uint64_t raw)
{
    uint8_t *p = data + start / 8;
    int32_t top = start % 8 + 1, left = length; /* bits of this byte that are ours, from the top */
    while (left > 0) {
        int32_t n = left < top ? left : top, low = top - n;
        uint8_t mask = (uint8_t)(mask_of(n) << low);
        left -= n;
        *p = (uint8_t)((*p & ~mask) | ((raw >> left << low) & mask));
        top = 8;
        p++;
    }
}

static uint64_t get_bits(const field_t *f, const uint8_t *data)
{
    const uint8_t *p = data + f->start / 8;
    if (f->motorola) return get_motorola(data, f->start, f->length);
    if (f->start % 8 == 0 && f->length == 32)
        return p[0] | (uint64_t)p[1] << 8 | (uint64_t)p[2] << 16 | (uint64_t)p[3] << 24;
    if (f->start % 8 == 0 && f->length == 16) return p[0] | (uint64_t)p[1] << 8;
    return get_intel(data, f->start, f->length);
}

static void put_bits(const field_t *f, uint8_t *data, uint64_t raw)
{
    uint8_t *p = data + f->start / 8;
    if (f->motorola) {
        put_motorola(data, f->start, f->length, raw);
    } else if (f->start % 8 == 0 && f->length == 32) {
        p[0] = (uint8_t)raw;
        p[1] = (uint8_t)(raw >> 8);
        p[2] = (uint8_t)(raw >> 16);
        p[3] = (uint8_t)(raw >> 24);
    } else if (f->start % 8 == 0 && f->length == 16) {
        p[0] = (uint8_t)raw;
        p[1] = (uint8_t)(raw >> 8);
    } else {
        put_intel(data, f->start, f->length, raw);
    }
}

/* ---- numbers ---- */

static int32_t finite(double x) { return x - x == 0.0; }

/* To the nearest integer, halves to even, as IEEE 754 adds: beyond 2^52 there are no fractions. */
static double rounded(double x)
{
    const double big = 4503599627370496.0;
    if (x >= big || x <= -big) return x;
    return x >= 0 ? (x + big) - big : (x - big) + big;
}

static double double_of(int64_t bits)
{
    double x;
    memcpy(&x, &bits, sizeof x);
    return x;
}

static uint64_t float_bits(const field_t *f, double value, header_t *header)
{
    double low = double_of(f->low), high = double_of(f->high), raw = (value - f->offset) / f->scale;
    float single;
    uint32_t bits;
    uint64_t wide;
    if (!finite(raw)) {
        header->saturated++;
        if (f->has_invalid) return f->length == 32 ? 0x7FC00000u : (uint64_t)0x7FF8 << 48;
        raw = (0.0 - f->offset) / f->scale;
    } else if (raw < low || raw > high) {
        header->saturated++;
    }
    raw = raw < low ? low : raw > high ? high : raw;
    single = (float)raw;
    memcpy(&bits, &single, sizeof bits);
    memcpy(&wide, &raw, sizeof wide);
    return f->length == 32 ? bits : wide;
}

static uint64_t integer_bits(const field_t *f, double value, header_t *header)
{
    double x = value;
    if (!finite(x)) {
        header->saturated++;
        if (f->has_invalid) return (uint64_t)f->invalid;
        x = 0.0;
    }
    x = rounded((x - f->offset) / f->scale);
    if (x > (double)f->low && x < (double)f->high) return (uint64_t)(int64_t)x;
    if (x == (double)f->low) return (uint64_t)f->low;
    if (x == (double)f->high) return (uint64_t)f->high;
    header->saturated += finite(value) ? 1 : 0;
    return (uint64_t)(x > (double)f->high ? f->high : f->low);
}

static int64_t extended(const field_t *f, uint64_t raw)
{
    uint64_t sign = (uint64_t)1 << (f->length - 1);
    return (int64_t)(f->kind == FIELD_SIGNED ? (raw ^ sign) - sign : raw);
}

static int32_t integer_value(const field_t *f, uint64_t bits, double *value)
{
    int64_t raw = extended(f, bits);
    *value = (double)raw * f->scale + f->offset;
    if (f->has_invalid && raw == f->invalid) return DECODE_INVALID;
    return raw < f->low || raw > f->high ? DECODE_RANGE : DECODE_OK;
}

static int32_t float_value(const field_t *f, uint64_t bits, double *value)
{
    uint32_t narrow = (uint32_t)bits;
    float single;
    double raw;
    memcpy(&single, &narrow, sizeof single);
    raw = f->length == 32 ? (double)single : double_of((int64_t)bits);
    *value = raw * f->scale + f->offset;
    if (!finite(*value)) return DECODE_INVALID;
    return raw < double_of(f->low) || raw > double_of(f->high) ? DECODE_RANGE : DECODE_OK;
}

/* ---- messages ---- */

static void put_header(const message_t *m, int32_t number, uint32_t value, uint8_t *data)
{
    const field_t *f = &m->header[number];
    put_bits(f, data, (uint64_t)((double)value / f->scale));
}

static uint32_t get_header(const message_t *m, int32_t number, const uint8_t *data)
{
    const field_t *f = &m->header[number];
    return (uint32_t)(int64_t)((double)get_bits(f, data) * f->scale);
}

void message_encode(const message_t *m, const double *values, header_t *header, frame_t *frame)
{
    int32_t i, filled = m->length < 64 ? m->length : 64;
    uint8_t *data = frame->data;

    frame->id = m->id;
    frame->flags = m->flags;
    frame->length = m->length;
    memcpy(data, m->fill, (size_t)filled);
    memset(data + filled, 0, (size_t)(m->length - filled));
    header->saturated = 0;
    for (i = 0; i < m->n_fields; i++) {
        const field_t *f = &m->fields[i];
        put_bits(f, data,
                 f->kind == FIELD_FLOAT ? float_bits(f, values[i], header)
                                        : integer_bits(f, values[i], header));
    }
    if (m->status >= 0) put_header(m, m->status, header->status, data);
    if (m->time >= 0) put_header(m, m->time, header->t_us, data);
    e2e_protect(m->e2e, m->data_ids, header->counter, data, m->length);
}

/* Whether encoding what was read gives the same bytes again, but for the values themselves: -0.0 is
 * read as 0.0. */
static int32_t reproduced(const message_t *m, const frame_t *frame, const double *values, header_t header)
{
    frame_t again;
    message_encode(m, values, &header, &again);
    for (int32_t i = 0; i < m->n_fields; i++)
        put_bits(&m->fields[i], again.data, get_bits(&m->fields[i], frame->data));
    return !memcmp(again.data, frame->data, m->length);
}

int32_t message_decode(const message_t *m, const frame_t *frame, double *values, header_t *header)
{
    double found[MESSAGE_FIELDS];
    const uint8_t *data = frame->data;
    int32_t i,
        result = frame->length == m->length && m->n_fields <= MESSAGE_FIELDS ? DECODE_OK : DECODE_LENGTH;

    if (result == DECODE_OK) result = e2e_check(m->e2e, m->data_ids, data, m->length, &header->counter);
    if (result != DECODE_OK) return result;
    header->status = m->status < 0 ? 0 : get_header(m, m->status, data);
    header->t_us = m->time < 0 ? 0 : get_header(m, m->time, data);
    header->saturated = 0;
    for (i = 0; i < m->n_fields && result == DECODE_OK; i++) {
        const field_t *f = &m->fields[i];
        uint64_t bits = get_bits(f, data);
        result = f->kind == FIELD_FLOAT ? float_value(f, bits, &found[i]) : integer_value(f, bits, &found[i]);
    }
    if (result == DECODE_OK && m->exact && !reproduced(m, frame, found, *header)) result = DECODE_INVALID;
    if (result == DECODE_OK) memcpy(values, found, (size_t)m->n_fields * sizeof *values);
    return result;
}
