/* replay.c: a node's slots once more, along its recording; see replay.h. */
#include "replay.h"

#include "slot.h"

API int32_t node_replay(node_t *n)
{
    while (n->replay_row < n->replayed_rows) {
        const row_t *row = (const row_t *)(n->replayed + n->replay_row * n->row_size);
        const uint32_t flags = row->flags & ~(uint32_t)ROW_FAILED;
        const int32_t failed = (row->flags & ROW_FAILED) != 0;
        const int32_t result = node_slot(n, row->deadline_ns, row->woke_ns, flags);
        if (result && !failed) return result;
    }
    return 0;
}
