/* bus_begin.c - the bus of an instance, at time 0. */
#include <string.h>

#include "core.h"

static bus_settings_t settings(bus_node_settings_t nodes[N_NODES])
{
    bus_settings_t set;
    memset(&set, 0, sizeof set);
    memset(nodes, 0, N_NODES * sizeof *nodes);
    for (int32_t i = 0; i < N_NODES; i++) {
        nodes[i].queue = QUEUE_SORTED, nodes[i].queue_length = QUEUE, nodes[i].inbox = 4 * QUEUE;
        nodes[i].recovers = 1, nodes[i].sample_point = SAMPLE_POINT, nodes[i].sjw = JUMP_WIDTH;
    }
    set.bit = BIT_PS, set.data_bit = DATA_BIT_PS, set.nodes = nodes, set.n_nodes = N_NODES;
    set.record = 1u << EVENT_STARTED | 1u << EVENT_SENT | 1u << EVENT_RECEIVED | 1u << EVENT_LOST |
                 1u << EVENT_ERROR | 1u << EVENT_DROPPED;
    return set;
}

static size_t size_of_bus(void)
{
    bus_node_settings_t nodes[N_NODES];
    const bus_settings_t set = settings(nodes);
    return (bus_size(&set) + 15) / 16 * 16;
}

size_t core_room(void) { return 2 * size_of_bus(); }

fmi3Status core_begin(fmu_t *x)
{
    bus_node_settings_t nodes[N_NODES];
    const bus_settings_t set = settings(nodes);
    x->size = size_of_bus();
    x->memory = x->room, x->saved = x->room + x->size;
    x->bus = bus_create(x->memory, &set);
    x->requests = 0, x->started = -1;
    x->n_waiting = x->n_contenders = 0;
    for (int32_t i = 0; i < N_NODES; i++) x->discards[i] = x->off[i] = false;
    return fmi3OK;
}
