/* rollback.c: the states of components in macro steps, saved and restored, and the vectors of their group. */
#include "engine_internal.h"

SHARED macro_memory_t memory_of(const macro_t *m)
{
    double *at = m->memory;
    macro_memory_t found;
    found.inputs = at, at += m->n_inputs;
    found.held = at, at += m->n_inputs;
    found.start = at, at += m->n_outputs;
    found.first = at, at += m->n_outputs;
    found.last = at, at += m->n_outputs;
    found.end = at, at += m->n_outputs;
    found.largest = at;
    return found;
}

/* Save the state of a unit, or go back to it: MOVE_... */
SHARED int move_state(const engine_t *e, rollback_t *r, int what, failure_t *failure)
{
    unit_t *u = e->units + r->unit;
    const int back = what & 1, end = what >> 1;
    char *copy = r->copies[end];
    int status = 0;

    for (int64_t i = 0; i < r->n_blocks; copy += r->blocks[i].size, i++)
        memcpy(back ? (char *)r->blocks[i].place : copy, back ? copy : (char *)r->blocks[i].place,
               (size_t)r->blocks[i].size);
    if (back && u->exchange) u->exchange->fresh = 1;
    if (r->call) status = ((saving_t)r->call)(r->unit, what) ? 3 : 0;
    else
        status = back ? ((state_t)r->restore)(u->instance, r->states[end])
                      : ((state_t)r->save)(u->instance, &r->states[end]);
    if (!failed_call(status)) return RUN_OK;
    failure->index = r->unit;
    failure->status = status;
    return RUN_STATE;
}

SHARED int move_states(const engine_t *e, macro_t *m, int what, int coupled, failure_t *failure)
{
    int result = RUN_OK;
    for (int64_t i = 0; i < m->n_members && result == RUN_OK; i++)
        if (m->members[i].coupled >= coupled) result = move_state(e, m->members + i, what, failure);
    return result;
}
