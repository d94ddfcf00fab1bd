/* plan.c - the plan of a node's components, executed as engine.c does; see portable.h. */
#include "portable.h"

#include <string.h>

static void move(const move_t *moves, int32_t n, const double *from, double *to)
{
    for (int32_t i = 0; i < n; i++)
        memcpy(to + moves[i].to, from + moves[i].from, (size_t)moves[i].count * sizeof *to);
}

const char *plan_begin(portable_t *x)
{
    memory_t *m = &x->memory;
    for (int32_t i = 0; i < N_UNITS; i++) {
        const unit_t *u = node_units + i;
        double *variables = m->kernels + u->first;
        x->who = u->name;
        if (u->kernel->size() != (size_t)u->size) return "found a kernel of another size";
        u->kernel->reset(variables);
        move(u->given, u->n_given, u->values, variables);
        move(u->inputs, u->n_inputs, m->signals, variables);
        const char *why = u->kernel->initial(variables);
        if (why) return why;
    }
    memcpy(m->seen, m->signals, sizeof m->seen);
    return NULL;
}

static int finite(const double *x, int32_t n)
{
    int all = 1;
    for (int32_t i = 0; i < n; i++) all &= x[i] - x[i] == 0.0;
    return all;
}

static const char *step(portable_t *x, int32_t index, int64_t tick)
{
    const unit_t *u = node_units + index;
    memory_t *m = &x->memory;
    double *variables = m->kernels + u->first;
    x->who = u->name;
    move(u->inputs, u->n_inputs, m->signals, variables);
    const char *why = u->kernel->step(variables, (double)(tick - u->lag) * H, u->h);
    if (why) return why;
    move(u->outputs, u->n_outputs, variables, m->signals);
    for (int32_t i = 0; i < u->n_outputs; i++)
        if (!finite(m->signals + u->outputs[i].to, u->outputs[i].count))
            return "found an output that is not finite";
    return NULL;
}

static const char *carry_out(portable_t *x, const plan_operation_t *op, int64_t tick)
{
    memory_t *m = &x->memory;
    double *s = m->signals;
    switch (op->code) {
    case PLAN_COPY:
        for (int32_t i = 0; i < op->count; i++)
            s[op->target + i] = op->gain == 1.0 && op->offset == 0.0
                                    ? s[op->source + i]
                                    : op->gain * s[op->source + i] + op->offset;
        return NULL;
    case PLAN_STEP: return step(x, op->index, tick);
    case PLAN_PLAY: {
        const played_values_t *p = node_players + op->index;
        const int64_t row = (tick - op->first) / op->period;
        s[op->target] = p->values[row < p->count ? row : p->count - 1];
        return NULL;
    }
    case PLAN_GATE:
        return m->gates[op->index].passing(m->gates[op->index].context, tick, s)
                   ? "found an input or output that stops the node"
                   : NULL;
    default:
        memcpy(m->seen, s, sizeof m->seen);
        if (x->record) memcpy(x->record, s, sizeof m->seen);
        return NULL;
    }
}

int32_t plan_run(void *context, int64_t ticks)
{
    portable_t *x = context;
    const int64_t tick = x->memory.node.slot;
    (void)ticks; /* one */
    for (int32_t i = 0; i < N_OPERATIONS; i++) {
        const plan_operation_t *op = node_operations + i;
        if (tick < op->first || (tick - op->first) % op->period) continue;
        x->why = carry_out(x, op, tick);
        if (x->why) return 1;
    }
    return 0;
}
