/* idle.c: sleep of a node until its next deadline; see idle.h. */
#include "idle.h"

#include "bus_wait.h"
#include "dispatch.h"

/* The deadline, or an earlier time at which a frame is due whose stamp was ahead of this clock (two clocks
 * drift between two comparisons of bus.h). */
static int64_t wake_at(const node_t *n, int64_t deadline_ns)
{
    for (int32_t b = 0; b < n->n_buses; b++)
        if (n->has_pending[b] && n->pending[b].t_ns < deadline_ns) deadline_ns = n->pending[b].t_ns;
    return deadline_ns;
}

int64_t node_idle(node_t *n, int64_t deadline_ns)
{
    int64_t now;
    if (!n->gateway) return pace_wait(deadline_ns, n->spin_ns, &n->quit);
    while ((now = pace_now()) < deadline_ns && !*(volatile int32_t *)&n->quit) {
        bus_wait(n->buses, n->n_buses, wake_at(n, deadline_ns));
        node_hear(n, n->start_ns ? pace_now() - n->start_ns : INT64_MAX);
    }
    return now;
}
