/* life_cycle.c: the life cycle of a node; see life_cycle.h. */
#include "life_cycle.h"

/* Why a command that needs a quiet node is refused; 0: it is not. */
static uint32_t not_quiet(const life_t *life, uint32_t now)
{
    if (life->state != LIFE_INACTIVE) return WHY_COMMAND;
    return life->reasons | now;
}

static uint32_t arm(life_t *life, uint32_t now)
{
    const uint32_t why = not_quiet(life, now);
    if (!why) life->armed = 1;
    return why;
}

static uint32_t start(life_t *life, uint32_t now)
{
    const uint32_t why = not_quiet(life, now);
    if (why) return why;
    if (!life->armed) return WHY_COMMAND;
    life->state = LIFE_ACTIVE;
    return 0;
}

static uint32_t reset(life_t *life)
{
    if (life->state != LIFE_INACTIVE && life->state != LIFE_FAULT) return WHY_COMMAND;
    life->state = LIFE_INACTIVE;
    life->armed = 0;
    life->reasons = 0;
    return 0;
}

/* Applies a command; returns the bits it raises. */
static uint32_t apply(life_t *life, uint32_t command, uint32_t now)
{
    switch (command) {
    case COMMAND_NONE: return 0;
    case COMMAND_ARM: life->refused = arm(life, now); return 0;
    case COMMAND_START: life->refused = start(life, now); return 0;
    case COMMAND_RESET: life->refused = reset(life); return 0;
    case COMMAND_STOP:
        life->refused = 0;
        if (life->state == LIFE_INACTIVE) life->armed = 0;
        return life->state == LIFE_ACTIVE ? WHY_COMMAND : 0;
    default: return WHY_COMPONENT;
    }
}

/* Applies the commands of a tick; returns the bits they raise. */
static uint32_t obey(life_t *life, uint32_t now)
{
    uint32_t left = life->commands, raised = 0;
    life->commands = 0;
    if (commands_have(left, COMMAND_STOP)) return apply(life, COMMAND_STOP, now);
    if (left && now & WHY_ESTOP) {
        life->refused = WHY_ESTOP;
        return 0;
    }
    for (; left; left >>= 3) raised |= apply(life, left & 7, now);
    return raised;
}

/* Latches what was raised, where the state lets it. */
static void latch(life_t *life, uint32_t raised)
{
    if (life->state == LIFE_INACTIVE && !life->armed) raised &= ~(uint32_t)WHY_NOT_YET;
    if (!raised || life->state == LIFE_FINISHED) return;
    life->reasons |= raised;
    life->armed = 0;
    if (life->state == LIFE_ACTIVE) {
        life->state = LIFE_STOPPING;
        life->ramp = life->ramp_ticks;
    } else if (life->state == LIFE_INACTIVE) {
        life->state = LIFE_FAULT;
    }
}

/* A node whose drive is off has nothing to ramp down. */
static void cut_ramp(life_t *life)
{
    if (life->moves && life->reasons & WHY_DRIVE && life->state == LIFE_STOPPING) life->ramp = 1;
}

/* One tick of the ramp. Stopped by command only: INACTIVE, else FAULT. */
static void ramp_down(life_t *life)
{
    if (life->ramp > life->ramp_ticks) life->ramp = life->ramp_ticks;
    life->ramp = life->ramp > 1 ? life->ramp - 1 : 0;
    if (life->ramp == 0) life->state = life->reasons & ~(uint32_t)WHY_COMMAND ? LIFE_FAULT : LIFE_INACTIVE;
}

static double scale(const life_t *life)
{
    if (life->state == LIFE_ACTIVE) return 1.0;
    return life->state == LIFE_STOPPING ? (double)life->ramp / life->ramp_ticks : 0.0;
}

API int32_t life_step(life_t *life)
{
    uint32_t raised = life->now;
    life->now = 0;
    if (life->state < LIFE_UNCONFIGURED || life->state > LIFE_FINISHED) {
        life->state = LIFE_FAULT;
        raised |= WHY_COMPONENT;
    }
    raised |= obey(life, raised);
    latch(life, raised);
    cut_ramp(life);
    if (life->state == LIFE_STOPPING) ramp_down(life);
    life->scale = scale(life);
    return life->state;
}
