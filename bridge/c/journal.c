/* journal.c: memory and disk of a journal, in pieces; see journal.h. */
#if defined(__linux__) && !defined(NODE_FIRMWARE)
#define _GNU_SOURCE /* MAP_POPULATE */
#endif
#include "journal.h"

#if defined(__linux__) && !defined(NODE_FIRMWARE)

#include <errno.h>
#include <fcntl.h>
#include <sys/mman.h>

enum { PAGE = 65536 }; /* a multiple of that of any system */

static uint64_t whole_pages(uint64_t bytes) { return (bytes + PAGE - 1) / PAGE * PAGE; }

API journal_t *journal_reserve(int32_t descriptor, uint64_t bytes)
{
    const int flags = MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE;
    journal_t *j = mmap(NULL, whole_pages(bytes), PROT_NONE, flags, -1, 0);
    if (j == MAP_FAILED) return NULL;
    errno = posix_fallocate(descriptor, 0, (off_t)(bytes < PAGE ? bytes : PAGE));
    if (!errno && mmap(j, PAGE, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_FIXED | MAP_POPULATE, descriptor,
                       0) == (void *)j)
        return j;
    const int failed = errno;
    journal_release(j, bytes);
    errno = failed;
    return NULL;
}

API void journal_release(journal_t *j, uint64_t bytes) { munmap(j, whole_pages(bytes)); }

/* Pages that are written stay in the page cache, but need not stay in memory. */
static void unlock_written(journal_t *j)
{
    const uint64_t written = JOURNAL_ROWS + __atomic_load_n(&j->rows, __ATOMIC_RELAXED) * j->row_size;
    if (written > 2 * PAGE) munlock((char *)j + PAGE, written / PAGE * PAGE - PAGE);
}

API int32_t journal_grow(journal_t *j, uint64_t rows)
{
    const uint64_t have = __atomic_load_n(&j->limit, __ATOMIC_ACQUIRE);
    const uint64_t most = rows < j->capacity ? rows : j->capacity;
    if (most <= have || !j->descriptor) return 0;
    const int descriptor = (int)j->descriptor - 1;
    const uint64_t from = (JOURNAL_ROWS + have * j->row_size) / PAGE * PAGE;
    const uint64_t to = whole_pages(JOURNAL_ROWS + most * j->row_size);
    const int flags = MAP_SHARED | MAP_FIXED | MAP_POPULATE;
    const uint64_t end = JOURNAL_ROWS + j->capacity * j->row_size + j->description;
    const int failed = posix_fallocate(descriptor, (off_t)from, (off_t)((to < end ? to : end) - from));
    if (failed) return failed;
    if (mmap((char *)j + from, to - from, PROT_READ | PROT_WRITE, flags, descriptor, (off_t)from) ==
        MAP_FAILED)
        return errno;
    const uint64_t room = (to - JOURNAL_ROWS) / j->row_size;
    const uint64_t now = room < j->capacity ? room : j->capacity;
    uint64_t limit = have;
    while (limit < now &&
           !__atomic_compare_exchange_n(&j->limit, &limit, now, 0, __ATOMIC_RELEASE, __ATOMIC_RELAXED)) {}
    unlock_written(j);
    return 0;
}

#else

API journal_t *journal_reserve(int32_t descriptor, uint64_t bytes)
{
    (void)descriptor, (void)bytes;
    return NULL;
}

API void journal_release(journal_t *j, uint64_t bytes) { (void)j, (void)bytes; }

API int32_t journal_grow(journal_t *j, uint64_t rows)
{
    (void)j, (void)rows;
    return 0;
}

#endif
