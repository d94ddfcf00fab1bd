/* motor.h: an emulated drive of a vendor, between the bus and a torque input of a plant. */
#ifndef BRIDGE_MOTOR_H
#define BRIDGE_MOTOR_H

#include "vendor.h"

/* What its vendor's state machine makes of a slot: torque acts, it has an error, it has a feedback of the
 * first kind to send, of the second. In the journal: a replay has these bits and no vendor. */
enum { MOTOR_ACTS = 1, MOTOR_FAULT = 2, MOTOR_OWES = 4 };

/* Something that happens to a drive: VENDOR_TRIP ..., at this time of the run. Also to one of our own protocol. */
typedef struct {
    int64_t t_ns;
    int32_t fault, code;
} motor_fault_t;

typedef struct {
    vendor_t vendor;
    int32_t bus;                   /* its number in the node */
    int32_t outlets[VENDOR_PARTS]; /* numbers of the messages with its feedback; -1: not sent */
    int32_t reserved;
    int64_t power;               /* MOTOR_ bits of this slot */
    const motor_fault_t *faults; /* in the order of time */
    int32_t n_faults, happened;
} motor_t;

#endif
