/* lsbus.h - an FMU of FMI 3.0 for co-simulation with CAN terminals, by FMI-LS-BUS 1.0.
 *
 * lsbus_fmi3.c and lsbus_refused.c contain the functions of FMI. The behaviour of the FMU is its core, which
 * defines `struct fmu` in core.h, beginning with LSBUS_MEMBERS, and the functions core_... below. Each
 * terminal has four variables (see `variable`). What arrives in Rx_Data is carried out by core_settle;
 * what is to be sent is in `tx` until the Tx_Clock ticks at the time that core_schedule has announced.
 */
#ifndef LSBUS_H
#define LSBUS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "fmi3.h"

enum { ROOM = 1 << 15 };
/* Value references: 4 * terminal + 1 and the three after it; then, behind all terminals, the
 * independent variable. */
enum { TX_CLOCK = 1, RX_CLOCK, TX_DATA, RX_DATA };
enum { INSTANTIATED = 1, INITIALIZATION = 2, EVENT = 4, STEPPING = 8, TERMINATED = 16 };

#define NEVER INT64_MAX

typedef struct {
    uint8_t rx[ROOM], tx[ROOM]; /* operations for the FMU, and from it */
    size_t n_rx, n_tx;
    int64_t tick;      /* ps, of its Tx_Clock; NEVER */
    bool rx_on, tx_on; /* its clocks, in this instant */
    bool changed;      /* the importer has not asked for `tick` yet */
} port_t;

/* What every `struct fmu` begins with. now: ps; room: core_room() bytes, 16-byte aligned. */
#define LSBUS_MEMBERS(n_ports)           \
    fmi3LogMessageCallback log;          \
    fmi3InstanceEnvironment environment; \
    unsigned mode;                       \
    int64_t now;                         \
    uint8_t *room;                       \
    char message[256];                   \
    port_t ports[n_ports]

typedef struct fmu fmu_t;

/* Operations: codes, and parameters of Configuration. */
enum {
    OP_FORMAT_ERROR = 0x01,
    OP_TRANSMIT = 0x10,
    OP_FD_TRANSMIT = 0x11,
    OP_CONFIRM = 0x20,
    OP_LOST = 0x30,
    OP_BUS_ERROR = 0x31,
    OP_CONFIGURATION = 0x40,
    OP_STATUS = 0x41,
    OP_WAKEUP = 0x42
};
enum { CAN_BAUDRATE = 1, CAN_FD_BAUDRATE, CAN_XL_BAUDRATE, LOST_BEHAVIOR };

/* A number of so many bytes, little endian. */
static inline uint32_t number(const uint8_t *b, int bytes)
{
    uint32_t found = 0;
    for (int i = 0; i < bytes; i++) found |= (uint32_t)b[i] << 8 * i;
    return found;
}

/* A transmit operation, checked: the frame's parts; its data begin at `first`. */
typedef struct {
    size_t first;
    uint32_t id, length;
    bool extended, second, esi; /* second: BRS of an FD frame, RTR of another */
} transmit_t;

/* Whether the `n` bytes are a transmit operation of this kind of frame. */
static inline bool transmit_of(const uint8_t *raw, size_t n, bool fd, transmit_t *of)
{
    of->first = fd ? 17 : 16;
    if (n < of->first) return false;
    of->id = number(raw + 8, 4), of->length = number(raw + of->first - 2, 2);
    of->extended = raw[12], of->second = raw[13], of->esi = fd && raw[14];
    if (raw[12] > 1 || raw[13] > 1 || (fd && raw[14] > 1)) return false;
    return !(of->id >> (of->extended ? 29 : 11)) && n == of->first + of->length &&
           of->length <= (fd ? 64u : 8u);
}

/* The same into `tx`, where there is room for it. */
static inline void put(port_t *p, uint32_t value, int bytes)
{
    for (int i = 0; i < bytes; i++) p->tx[p->n_tx++] = (uint8_t)(value >> 8 * i);
}

/* The header of an operation of `length` bytes into `tx`; false: there is no room for it. */
static inline bool put_head(port_t *p, uint32_t code, size_t length)
{
    if (p->n_tx + length > ROOM) return false;
    put(p, code, 4), put(p, (uint32_t)length, 4);
    return true;
}

/* Log a message and return fmi3Error. */
fmi3Status lsbus_refuse(fmu_t *x, const char *format, ...);
/* Empty all ports; time 0. */
void lsbus_begin(fmu_t *x);

/* Bytes of memory that the core needs besides `struct fmu`. */
size_t core_room(void);
/* All at time 0, after lsbus_begin. */
fmi3Status core_begin(fmu_t *x);
/* Go on to `until` (ps). */
fmi3Status core_go(fmu_t *x, int64_t until);
/* Put into `tx` what is sent in this instant, in which a Tx_Clock ticks. */
fmi3Status core_tick(fmu_t *x);
/* Carry out what has arrived in this instant. */
fmi3Status core_settle(fmu_t *x);
/* Find out when each Tx_Clock ticks next. */
void core_schedule(fmu_t *x);
/* How many values a Float64 output has, and where; 0: there is no such output. */
size_t core_float64(fmu_t *x, fmi3ValueReference vr, const double **values);
/* Whether there is a Boolean with this value reference, and its value. */
bool core_boolean(fmu_t *x, fmi3ValueReference vr, fmi3Boolean *value);

#endif
