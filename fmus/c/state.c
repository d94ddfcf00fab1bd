/* state.c - saving, restoring and serialising an instance.
 *
 * Serialised form, little-endian, the same from every platform and from FMI 2.0 and 3.0:
 *
 *     0  u64  MARK               24  u32  mode, one of the bits of instance.h
 *     8  u32  FORMAT             28  u32  1 where calculated variables are stale
 *    12  u32  number of values   32  f64  start time, s
 *    16  u64  layout of Model    40  f64  stop time, s (infinite: none)
 *    48  f64  values in the order of the declaration, then the time
 *             of a model with a clock then: ticks, 1 where it is active, 1 where the importer
 *             ticks, and values and time before the tick
 *   end  u32  CRC-32 (IEEE 802.3) of everything before
 */
#include <stdlib.h>
#include <string.h>

#include "instance.h"

#define MARK UINT64_C(0x554d466d69736f63) /* "cosimFMU" as bytes */

enum { FORMAT = 1, HEADER = 48 };

#define N_VALUES (N_STORED + (declared.is_clocked ? 3 + N_STORED : 0))
#define SIZE (HEADER + 8 * (size_t)N_VALUES + 4)

struct Snapshot {
    uint64_t mark; /* tells a saved state from another pointer */
    uint32_t mode, stale;
    double start_time, stop_time;
    double values[]; /* N_VALUES */
};

static void put(unsigned char *bytes, uint64_t value, int n)
{
    for (int i = 0; i < n; i++) bytes[i] = (unsigned char)(value >> (8 * i));
}

static uint64_t take(const unsigned char *bytes, int n)
{
    uint64_t value = 0;
    for (int i = 0; i < n; i++) value |= (uint64_t)bytes[i] << (8 * i);
    return value;
}

static void put_double(unsigned char *bytes, double value)
{
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    put(bytes, bits, 8);
}

static double take_double(const unsigned char *bytes)
{
    const uint64_t bits = take(bytes, 8);
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static uint32_t crc32(const unsigned char *bytes, size_t n)
{
    uint32_t crc = 0xffffffffu;
    for (size_t i = 0; i < n; i++) {
        crc ^= bytes[i];
        for (int k = 0; k < 8; k++) crc = crc >> 1 ^ (crc & 1 ? 0xedb88320u : 0);
    }
    return ~crc;
}

static void clock_to(double *values, const Clock *clock)
{
    if (!declared.is_clocked) return;
    values[0] = clock->count;
    values[1] = clock->active;
    values[2] = clock->used;
    memcpy(values + 3, clock->before, N_STORED * sizeof *values);
}

static void clock_from(const double *values, Clock *clock)
{
    if (!declared.is_clocked) return;
    clock->count = values[0];
    clock->active = values[1] != 0.0;
    clock->used = values[2] != 0.0;
    memcpy(clock->before, values + 3, N_STORED * sizeof *values);
}

static int known(const Instance *x, const void *state, const char *function)
{
    if (state != NULL && ((const Snapshot *)state)->mark == MARK) return 1;
    refuse(x, function, "the state is %s", state == NULL ? "null" : "none saved by this FMU");
    return 0;
}

/* `*state`, or new memory if that is NULL. Returns NULL after logging a message if there is no memory. */
static Snapshot *room(const Instance *x, void **state, const char *function)
{
    if (state == NULL) {
        refuse(x, function, "the pointer to the state is null");
        return NULL;
    }
    if (*state != NULL) return known(x, *state, function) ? *state : NULL;
    Snapshot *made = calloc(1, sizeof *made + N_VALUES * sizeof *made->values);
    if (made == NULL) refuse(x, function, "no memory for a state");
    return made;
}

Status state_save(const Instance *x, void **state, const char *function)
{
    Snapshot *y = room(x, state, function);
    if (y == NULL) return STATUS_ERROR;
    y->mark = MARK;
    y->mode = x->mode;
    y->stale = (uint32_t)x->stale;
    y->start_time = x->start_time;
    y->stop_time = x->stop_time;
    memcpy(y->values, x->values, N_STORED * sizeof *x->values);
    clock_to(y->values + N_STORED, &x->clock);
    *state = y;
    return STATUS_OK;
}

Status state_restore(Instance *x, const Snapshot *state, const char *function)
{
    if (!known(x, state, function)) return STATUS_ERROR;
    x->mode = state->mode;
    x->stale = (int)state->stale;
    x->start_time = state->start_time;
    x->stop_time = state->stop_time;
    memcpy(x->values, state->values, N_STORED * sizeof *x->values);
    clock_from(state->values + N_STORED, &x->clock);
    return STATUS_OK;
}

Status state_free(const Instance *x, void **state, const char *function)
{
    if (state == NULL) return refuse(x, function, "the pointer to the state is null");
    if (*state == NULL) return STATUS_OK;
    if (!known(x, *state, function)) return STATUS_ERROR;
    ((Snapshot *)*state)->mark = 0;
    free(*state);
    *state = NULL;
    return STATUS_OK;
}

Status state_size(const Instance *x, const Snapshot *state, size_t *size, const char *function)
{
    if (!known(x, state, function)) return STATUS_ERROR;
    if (size == NULL) return refuse(x, function, "the pointer to the size is null");
    *size = SIZE;
    return STATUS_OK;
}

Status state_write(const Instance *x, const Snapshot *state, unsigned char bytes[], size_t size,
                   const char *function)
{
    if (!known(x, state, function)) return STATUS_ERROR;
    if (bytes == NULL || size < SIZE)
        return refuse(x, function, "there is room for %lu bytes, expected %lu",
                      bytes == NULL ? 0ul : (unsigned long)size, (unsigned long)SIZE);
    put(bytes, MARK, 8);
    put(bytes + 8, FORMAT, 4);
    put(bytes + 12, N_VALUES, 4);
    put(bytes + 16, declared.layout, 8);
    put(bytes + 24, state->mode, 4);
    put(bytes + 28, state->stale, 4);
    put_double(bytes + 32, state->start_time);
    put_double(bytes + 40, state->stop_time);
    for (unsigned i = 0; i < N_VALUES; i++) put_double(bytes + HEADER + 8 * i, state->values[i]);
    put(bytes + SIZE - 4, crc32(bytes, SIZE - 4), 4);
    return STATUS_OK;
}

/* Whether the bytes are a state of this model, undamaged; otherwise that is logged. */
static int readable(const Instance *x, const unsigned char bytes[], size_t size, const char *function)
{
    if (bytes == NULL || size < HEADER)
        refuse(x, function, "%lu bytes are no serialised state, expected %lu",
               bytes == NULL ? 0ul : (unsigned long)size, (unsigned long)SIZE);
    else if (take(bytes, 8) != MARK) refuse(x, function, "the bytes are no state serialised by such an FMU");
    else if (take(bytes + 8, 4) != FORMAT)
        refuse(x, function, "the serialised state has format %lu, expected %d",
               (unsigned long)take(bytes + 8, 4), FORMAT);
    else if (take(bytes + 16, 8) != declared.layout || take(bytes + 12, 4) != N_VALUES)
        refuse(x, function, "the serialised state is of another model than %s", declared.identifier);
    else if (size != SIZE)
        refuse(x, function, "the serialised state has %lu bytes, expected %lu", (unsigned long)size,
               (unsigned long)SIZE);
    else if (take(bytes + SIZE - 4, 4) != crc32(bytes, SIZE - 4))
        refuse(x, function, "the serialised state is damaged (CRC-32 is %08lx, expected %08lx)",
               (unsigned long)crc32(bytes, SIZE - 4), (unsigned long)take(bytes + SIZE - 4, 4));
    else return 1;
    return 0;
}

/* Whether this FMU has such a mode. */
static int is_mode(uint32_t mode)
{
    const uint32_t event = declared.is_clocked ? EVENT : 0;
    const uint32_t configuration = declared.structural < declared.n_scalars ? CONFIGURATION : 0;
    const uint32_t exchange = INSTANTIATED | INITIALIZATION | EVENT | CONTINUOUS | TERMINATED;
    const uint32_t modes = declared.rates ? exchange : (2 * TERMINATED - 1) | event | configuration;
    return mode != 0 && (mode & ~modes) == 0 && (mode & (mode - 1)) == 0;
}

/* Whether the structural parameter is one that the arrays have room for. */
static int is_sized(const unsigned char bytes[])
{
    if (declared.structural == declared.n_scalars) return 1;
    const double size = take_double(bytes + HEADER + 8 * declared.structural);
    for (unsigned i = 0; i < declared.n_variables; i++)
        if (variables[i].access & IS_SIZE)
            return size >= variables[i].minimum && size <= variables[i].maximum &&
                   size == (double)(unsigned)size;
    return 0;
}

Status state_read(const Instance *x, const unsigned char bytes[], size_t size, void **state,
                  const char *function)
{
    if (!readable(x, bytes, size, function)) return STATUS_ERROR;
    const uint32_t mode = (uint32_t)take(bytes + 24, 4);
    if (!is_mode(mode)) return refuse(x, function, "the serialised state has mode %lu", (unsigned long)mode);
    if (!is_sized(bytes))
        return refuse(x, function, "the serialised state has an impossible structural parameter");
    Snapshot *y = room(x, state, function);
    if (y == NULL) return STATUS_ERROR;
    y->mark = MARK;
    y->mode = mode;
    y->stale = take(bytes + 28, 4) != 0;
    y->start_time = take_double(bytes + 32);
    y->stop_time = take_double(bytes + 40);
    for (unsigned i = 0; i < N_VALUES; i++) y->values[i] = take_double(bytes + HEADER + 8 * i);
    *state = y;
    return STATUS_OK;
}
