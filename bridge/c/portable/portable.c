/* portable.c - the start of a node, and its stubs for an operating system; see portable.h. */
#include "portable.h"

#include <string.h>

#include "delay.h"
#include "faults.h"

/* A copy of the node as it starts, which points into itself. */
static void copy(memory_t *m)
{
    memcpy(m, &node_first, sizeof *m);
    for (size_t i = 0; i < N_POINTERS; i++) {
        char *at = (char *)m + node_pointers[i], *pointer;
        memcpy(&pointer, at, sizeof pointer);
        pointer = (char *)m + (pointer - (const char *)&node_first);
        memcpy(at, &pointer, sizeof pointer);
    }
}

void portable_reset(portable_t *x)
{
    node_t *n = &x->memory.node;
    memset(x, 0, sizeof *x);
    copy(&x->memory);
    for (int32_t b = 0; b < N_BUSES; b++) x->buses[b].kind = BUS_MEMORY, x->buses[b].number = (uint32_t)b;
    n->buses = x->buses, n->pending = x->pending, n->has_pending = x->has_pending;
    n->journal = &x->none, n->record = &x->record, n->record_row = &x->record_row;
    n->engine = x, n->run = plan_run, n->signals = x->memory.signals;
    for (int32_t i = 0; i < n->n_inlets; i++) delay_reset(n->inlets[i].delay);
}

/* --- in place of the parts of a node that know systems and injected faults --------------------- */

void histogram_add(histogram_t *h, int64_t ns)
{
    if (h->count == 0 || ns < h->minimum) h->minimum = ns;
    if (h->count == 0 || ns > h->maximum) h->maximum = ns;
    h->count++;
    h->sum += (double)ns;
}

void faults_put(faults_t *f, const frame_t *frame, int64_t start_ns, int32_t started)
{
    (void)f, (void)frame, (void)start_ns, (void)started;
}

int32_t faults_get(faults_t *f, frame_t *frame, int64_t now_ns)
{
    (void)f, (void)frame, (void)now_ns;
    return 0;
}
