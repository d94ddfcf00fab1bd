/* journal.h: rows of one size appended to a file that is mapped into memory.
 *
 * Written rows are in the page cache and survive the end of the process (SIGKILL). The file is as long as
 * `capacity` rows from the start, but disk and memory are taken in pieces (Linux): the process's owner
 * makes room for more rows before they are written (journal_grow), and a writer that has none makes it
 * itself. Writing is a memcpy and one store. A journal that is full, or gets no more space, counts and
 * discards rows. The rows start at byte 64 of the mapping; a description of the rows, for readers only,
 * follows the last of `capacity` rows (bridge/native/journal.py). There is one writer.
 */
#ifndef BRIDGE_JOURNAL_H
#define BRIDGE_JOURNAL_H

#include <stddef.h>
#include <stdint.h>

#include "frame.h"

typedef struct {   /* the first 64 bytes of the file */
    char magic[8]; /* "cosimjnl" */
    uint32_t version, row_size;
    uint64_t capacity; /* rows */
    uint64_t rows;     /* written; moved after the row is there */
    uint64_t dropped;
    uint64_t description; /* bytes of text behind the rows */
    uint64_t limit;       /* rows for which there is space */
    int64_t descriptor;   /* while it is written: of the file, plus 1; 0: it does not grow */
} journal_t;

enum {
    JOURNAL_ROWS = 64 /* where the rows start */,
    JOURNAL_PIECE = 1 << 20 /* bytes of a piece that a writer takes */
};

/* A range of addresses for a file of so many bytes, of which the first page is there; NULL: errno, or this
 * system has no pieces. The file must be as long. */
API journal_t *journal_reserve(int32_t descriptor, uint64_t bytes);
API void journal_release(journal_t *j, uint64_t bytes);
/* Space for `rows` rows in all; 0, or the error number: then `limit` is as before. Two threads may call it,
 * also while a third one writes. */
API int32_t journal_grow(journal_t *j, uint64_t rows);

/* The place of the next row, to be filled and then committed; NULL when full (counted). */
static inline void *journal_next(journal_t *j)
{
    uint64_t n = SHARED_LOAD(&j->rows, __ATOMIC_RELAXED);
    if (n >= SHARED_LOAD(&j->limit, __ATOMIC_ACQUIRE) &&
        (n >= j->capacity || !j->descriptor || journal_grow(j, n + 1 + JOURNAL_PIECE / j->row_size))) {
        j->dropped++;
        return 0;
    }
    return (char *)j + JOURNAL_ROWS + n * j->row_size;
}
static inline void journal_commit(journal_t *j)
{
    SHARED_STORE(&j->rows, SHARED_LOAD(&j->rows, __ATOMIC_RELAXED) + 1, __ATOMIC_RELEASE);
}

#endif
