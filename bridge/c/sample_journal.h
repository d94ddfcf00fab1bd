/* sample_journal.h: the journal of the samples that a node has accepted. */
#ifndef BRIDGE_SAMPLE_JOURNAL_H
#define BRIDGE_SAMPLE_JOURNAL_H

#include "node.h"

/* Records a sample of r that was accepted, with r's values. */
void node_heard(node_t *n, const reception_t *r, int64_t sequence, int64_t arrival_ns, uint32_t status);

#endif
