/* epoch.h: the message EPOCH, which identifies the run on the buses and gives the date of its t = 0.
 *
 * EPOCH carries a number of the run, the sender's host, whether a time server synchronizes that host's
 * clock, and the origin: the date (CLOCK_REALTIME) of t = 0, us, a multiple of 10, modulo 2^33 * 10 us
 * (23.9 h). A receiver converts the origin to its own CLOCK_MONOTONIC, and accepts it if the sender
 * has the same clock: the same host, or both hosts are synchronized. The sender of START sends EPOCH
 * before START, and a running node sends it when a peer waits for a start. See run_epoch.h.
 *
 * A number of 8 bits does not tell hosts apart. Where there is room (Zenoh) the identity of the host
 * follows, 128 bits in four values. Elsewhere two frames come before each EPOCH, both EPOCHs of the host 0
 * whose run is the low bits of the sender's number: HOST, whose `kept` is 1 and whose origin is the first of
 * these values, and DATE, whose `kept` is 0 and whose origin is the date at which it is sent. A node without a
 * date (a microcontroller) takes that one, believes the EPOCH behind it, and sends none. A receiver that does
 * not know HOST takes it for a DATE, which the DATE behind it corrects. A gateway makes the HOST of an EPOCH from
 * Zenoh of the identity in it, since t = 0 is in the clock of that host; a DATE only if it has the same clock.
 */
#ifndef BRIDGE_EPOCH_H
#define BRIDGE_EPOCH_H

#include <stdint.h>

#include "frame.h"

/* Values of the message, in this order. */
enum { EPOCH_RUN, EPOCH_HOST, EPOCH_KEPT, EPOCH_ORIGIN, EPOCH_IDENTITY, EPOCH_VALUES = EPOCH_IDENTITY + 4 };
enum { EPOCH_DATE_HOST = 0, EPOCH_DATE_RUN = 63 /* mask of the sender's number in a DATE */ };
enum { EPOCH_RUNS = 63 };           /* runs are numbered from 1; 0: a run that was started without EPOCH */
enum { EPOCH_LEAD_NS = 100000000 }; /* from a START without EPOCH to t = 0 */

typedef struct {
    int64_t origin_ns;  /* t = 0 of the last accepted EPOCH, CLOCK_MONOTONIC; 0: none */
    int64_t heard_ns;   /* when it came */
    int64_t due_ns;     /* no EPOCH is sent before */
    int32_t run;        /* number of the run that this node is in or is to start */
    int32_t told;       /* number of the run in the last accepted EPOCH */
    int32_t host, kept; /* of this node's host: its number, 1 to 255; its date is kept: 1 */
    int32_t follows;    /* 1: no supervisor starts this node; it joins a run announced by EPOCH */
    int32_t running;    /* 1: an EPOCH of a run that has begun came, and was not looked at yet */
    int32_t asked;      /* 1: a peer waits for a start */
    int32_t unshared;   /* EPOCHs of hosts without a common clock */
    uint32_t said;      /* frames sent, and heard */
    int32_t heard;
    double identity[4]; /* of this node's host, 32 bits each */
    int64_t apart_ns;   /* the date in the last DATE, from ours */
    int64_t dated_ns;   /* when it came; 0: never */
    int64_t dated_host; /* EPOCH_DATE_RUN bits of the number of its host */
    int64_t date_ns;    /* of a node that `adopts` it: the date in the last DATE, less its arrival */
    int64_t named_ns;   /* when the last HOST came; 0: an EPOCH has come since */
    int32_t named_host; /* EPOCH_DATE_RUN bits of the number of its host */
    int32_t named;      /* it is ours: 1, another: -1 */
    int32_t adopts, reserved;
} epoch_t;

/* A number for the run with this t = 0 (any clock): nodes with the same t = 0 compute the same number. */
API int32_t epoch_run(int64_t origin_ns);
/* On this process's clock: t = 0 of a message with this origin (us) that came at arrival_ns. */
int64_t epoch_origin_ns(double us, int64_t arrival_ns);
/* The values of the HOST that goes before an EPOCH with these values. */
void epoch_host_values(const double *epoch, double *values);
/* Whether a HOST is ours: 1, or another: -1; 0: ours is not known. */
int32_t epoch_host_is(const epoch_t *e, const double *values);
/* The value in the message for a date of t = 0 (ns since 1970): us, a multiple of 10, modulo 2^33 * 10 us. */
API int64_t epoch_origin_us(int64_t date_ns);

#endif
