/* life_cycle.h: the life cycle of a node, and the status that travels with every sample.
 *
 * Deterministic: its inputs are recorded, so a replay takes the same decisions. Every rule, and how to
 * reset it: docs/safety.md. */
#ifndef BRIDGE_LIFE_CYCLE_H
#define BRIDGE_LIFE_CYCLE_H

#include <stdint.h>

#include "frame.h"

/* Status: the byte that travels with every sample. */
enum status {
    STATUS_LIFE = 7 /* mask: LIFE_ of the sender */,
    STATUS_DEADMAN = 1 << 3 /* held */,
    STATUS_ESTOP = 1 << 4 /* latched */,
    STATUS_SATURATED = 1 << 5,
    STATUS_STALE = 1 << 6,
    STATUS_SIMULATED = 1 << 7 /* a rehearsal: never for a real drive */
};

enum life_state { LIFE_UNCONFIGURED, LIFE_INACTIVE, LIFE_ACTIVE, LIFE_STOPPING, LIFE_FAULT, LIFE_FINISHED };
enum command { COMMAND_NONE, COMMAND_ARM, COMMAND_START, COMMAND_STOP, COMMAND_RESET };
/* The commands of one slot, in the order in which they came: octal digits, the first is the lowest. Of
 * more than ten the last ones are dropped, but never a STOP. */
enum { COMMANDS_BITS = 30 };
static inline uint32_t commands_add(uint32_t commands, int32_t command)
{
    int32_t bit = 0;
    while (bit < COMMANDS_BITS && commands >> bit & 7) bit += 3;
    if (bit == COMMANDS_BITS && command != COMMAND_STOP) return commands;
    if (bit == COMMANDS_BITS) bit -= 3, commands &= ~((uint32_t)7 << bit);
    return commands | (uint32_t)(command & 7) << bit;
}
/* Whether this command is among them. */
static inline int32_t commands_have(uint32_t commands, int32_t command)
{
    for (; commands; commands >>= 3)
        if ((int32_t)(commands & 7) == command) return 1;
    return 0;
}
/* Why: bits, latched in `reasons` until COMMAND_RESET. */
enum why {
    WHY_COMMAND = 1 << 0,
    WHY_ESTOP = 1 << 1,
    WHY_PEER = 1 << 2,
    WHY_STALE = 1 << 3,
    WHY_GUARD = 1 << 4,
    WHY_WATCHDOG = 1 << 5,
    WHY_OVERRUN = 1 << 6,
    WHY_COMPONENT = 1 << 7,
    WHY_BUS = 1 << 8,
    WHY_SYNC = 1 << 9,
    WHY_APART = 1 << 10,
    WHY_JUMP = 1 << 11,
    WHY_DRIVE = 1 << 12 /* a drive that it commands is not enabled */
};
/* What is normal before all nodes are ready: while a node is INACTIVE and not armed, these bits refuse
 * ARM and START in the tick that raises them, and are not latched. */
enum { WHY_NOT_YET = WHY_PEER | WHY_STALE | WHY_WATCHDOG | WHY_OVERRUN | WHY_SYNC | WHY_APART };

typedef struct {
    int32_t state, armed;
    uint32_t reasons;   /* latched */
    uint32_t now;       /* bits raised in this tick, by whoever; cleared by life_step */
    uint32_t commands;  /* of this tick; cleared by life_step */
    int32_t ramp_ticks; /* torque goes to 0 in so many ticks while STOPPING */
    int32_t ramp;       /* ticks of the ramp left */
    uint32_t refused;   /* why the last command was refused, WHY_COMMAND: not in this state; 0: it was not */
    double scale;       /* of the torque: 1 ACTIVE, falling STOPPING, 0 else */
    int32_t moves, reserved; /* it is the node of drives of our own protocol: where one is off, there is
                             * nothing to ramp down, and others have to know it at once */
} life_t;

/* One tick: applies the commands in their order, then the bits raised, which win. A STOP among them is
 * applied alone, and with an emergency stop (WHY_ESTOP raised) only a STOP is: the others are refused.
 * Returns the state.
 *
 *   ARM    INACTIVE, nothing latched, nothing raised            -> armed
 *   START  INACTIVE, armed, nothing latched, nothing raised     -> ACTIVE
 *   STOP   ACTIVE -> STOPPING, at the end of the ramp INACTIVE; INACTIVE: disarmed
 *   RESET  INACTIVE, FAULT -> INACTIVE, disarmed, nothing latched
 *   a bit  ACTIVE -> STOPPING, at the end of the ramp FAULT; INACTIVE -> FAULT (but see WHY_NOT_YET)
 *
 * UNCONFIGURED -> INACTIVE and any -> FINISHED are the node's. A node that is done raises STOP first.
 * A state or a command that does not exist is a fault of the node: WHY_COMPONENT. */
API int32_t life_step(life_t *life);

#endif
