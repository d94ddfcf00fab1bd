/* journal.h: rows of one size appended to a file that is mapped into memory.
 *
 * Written rows are in the page cache and survive the end of the process (SIGKILL). Python makes and
 * pre-faults the mapping; writing is a memcpy and one store. A full journal counts and discards rows.
 * The rows start at byte 64 of the mapping; a description of the rows, for readers only, follows the
 * last of `capacity` rows (bridge/native/journal.py). There is one writer.
 */
#ifndef BRIDGE_JOURNAL_H
#define BRIDGE_JOURNAL_H

#include <stddef.h>
#include <stdint.h>

typedef struct {            /* the first 64 bytes of the file */
    char magic[8];          /* "cosimjnl" */
    uint32_t version, row_size;
    uint64_t capacity;      /* rows */
    uint64_t rows;          /* written; moved after the row is there */
    uint64_t dropped;
    uint64_t description;   /* bytes of text behind the rows */
    uint64_t reserved[2];
} journal_t;

/* The place of the next row, to be filled and then committed; NULL when full (counted). */
static inline void *journal_next(journal_t *j)
{
    uint64_t n = __atomic_load_n(&j->rows, __ATOMIC_RELAXED);
    if (n >= j->capacity) {
        j->dropped++;
        return 0;
    }
    return (char *)j + 64 + n * j->row_size;
}
static inline void journal_commit(journal_t *j)
{
    __atomic_store_n(&j->rows, __atomic_load_n(&j->rows, __ATOMIC_RELAXED) + 1, __ATOMIC_RELEASE);
}

#endif
