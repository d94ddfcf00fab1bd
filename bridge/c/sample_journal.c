/* sample_journal.c: every accepted sample, as it was decoded, in a separate journal; see sample_journal.h.
 *
 * A replay takes its inputs from this journal, for any sender, and so needs no other node.
 */
#include "sample_journal.h"

#include <string.h>

void node_heard(node_t *n, const reception_t *r, int64_t sequence, int64_t arrival_ns, uint32_t status)
{
    heard_t *row = n->heard ? journal_next(n->heard) : 0;
    if (!row) return;
    row->sequence = sequence;
    row->arrival_ns = arrival_ns;
    row->message = (int32_t)(r - n->receptions);
    row->status = status;
    memcpy(row + 1, r->values, (size_t)r->width * sizeof *r->values);
    journal_commit(n->heard);
}
