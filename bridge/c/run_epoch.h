/* run_epoch.h: sending and receiving the identification of the run; the message is in epoch.h. */
#ifndef BRIDGE_RUN_EPOCH_H
#define BRIDGE_RUN_EPOCH_H

#include "node.h"

/* Sends EPOCH of this node's run on all buses. */
void node_epoch(node_t *n);
/* The same if a peer waits for a start, at most one in 100 ms. */
void node_epoch_answer(node_t *n);
/* EPOCH of another node, which announces its run to a waiting node. */
void node_epoch_heard(node_t *n, const frame_t *frame);
/* t = 0 of a START received at arrival_ns: that of an EPOCH in the second before, else lead_ns later. */
API int64_t node_origin(const node_t *n, int64_t arrival_ns, int64_t lead_ns);
/* The number of the run with this t = 0; told: by the owner of this process, not on a bus. */
int32_t node_run_of(const node_t *n, int64_t start_ns, int32_t told);

#endif
