/* faulty.c: loaded before the C library, lets the n-th call on files below a folder fail.
 *
 * FAULT_ROOT: the folder; FAULT_AT: which call of this process fails, from 1 on, 0: none;
 * FAULT_ERRNO: how it fails; FAULT_KEEP: if set, all later calls fail too. Calls counted: open,
 * write, ftruncate, truncate, rename, mkdir, fallocate and mmap of such a file. What is opened for
 * reading fails with EIO, and a disk that stays full (FAULT_KEEP with ENOSPC) can still be read.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <unistd.h>

#define FILES 4096
static char below[FILES];
static long calls;

static long number(const char *name)
{
    const char *text = getenv(name);
    return text ? atol(text) : 0;
}

static int concerned(const char *path)
{
    const char *root = getenv("FAULT_ROOT");
    char whole[4096];
    if (!root || !path) return 0;
    if (path[0] != '/') {
        char here[2048];
        if (!getcwd(here, sizeof here)) return 0;
        snprintf(whole, sizeof whole, "%s/%s", here, path);
        path = whole;
    }
    return strncmp(path, root, strlen(root)) == 0;
}

static int fails_as(int reads)
{
    long at = number("FAULT_AT"), n = __atomic_add_fetch(&calls, 1, __ATOMIC_SEQ_CST);
    int error = (int)number("FAULT_ERRNO");
    int later = n > at && getenv("FAULT_KEEP") && !(reads && error == ENOSPC);
    if (at <= 0 || (n != at && !later)) return 0;
    errno = reads ? EIO : error;
    return 1;
}
static int fails(void) { return fails_as(0); }
static int reads(int flags) { return (flags & O_ACCMODE) == O_RDONLY; }

long fault_calls(void) { return __atomic_load_n(&calls, __ATOMIC_SEQ_CST); }
void fault_begin(void) { __atomic_store_n(&calls, 0, __ATOMIC_SEQ_CST); }

#define REAL(name) __typeof__(&name) real = (__typeof__(&name))dlsym(RTLD_NEXT, #name)

static int opened(int fd, const char *path)
{
    if (fd >= 0 && fd < FILES) below[fd] = (char)concerned(path);
    return fd;
}
static int mine(int fd) { return fd >= 0 && fd < FILES && below[fd]; }

#define OPEN(name)                                                              \
    int name(const char *path, int flags, ...)                                  \
    {                                                                           \
        va_list more;                                                           \
        va_start(more, flags);                                                  \
        mode_t mode = flags & (O_CREAT | O_TMPFILE) ? va_arg(more, mode_t) : 0; \
        va_end(more);                                                           \
        REAL(name);                                                             \
        if (concerned(path) && fails_as(reads(flags))) return -1;               \
        return opened(real(path, flags, mode), path);                           \
    }
OPEN(open)
OPEN(open64)
#define OPENAT(name)                                                            \
    int name(int folder, const char *path, int flags, ...)                      \
    {                                                                           \
        va_list more;                                                           \
        va_start(more, flags);                                                  \
        mode_t mode = flags & (O_CREAT | O_TMPFILE) ? va_arg(more, mode_t) : 0; \
        va_end(more);                                                           \
        REAL(name);                                                             \
        if (concerned(path) && fails_as(reads(flags))) return -1;               \
        return opened(real(folder, path, flags, mode), path);                   \
    }
OPENAT(openat)
OPENAT(openat64)

int close(int fd)
{
    REAL(close);
    if (fd >= 0 && fd < FILES) below[fd] = 0;
    return real(fd);
}
ssize_t write(int fd, const void *data, size_t size)
{
    REAL(write);
    return mine(fd) && fails() ? -1 : real(fd, data, size);
}
#define TRUNCATE(name)                                    \
    int name(int fd, off_t size)                          \
    {                                                     \
        REAL(name);                                       \
        return mine(fd) && fails() ? -1 : real(fd, size); \
    }
TRUNCATE(ftruncate)
TRUNCATE(ftruncate64)
#define SHORTEN(name)                                              \
    int name(const char *path, off_t size)                         \
    {                                                              \
        REAL(name);                                                \
        return concerned(path) && fails() ? -1 : real(path, size); \
    }
SHORTEN(truncate)
SHORTEN(truncate64)
#define ALLOCATE(name)                                             \
    int name(int fd, off_t from, off_t size)                       \
    {                                                              \
        REAL(name);                                                \
        return mine(fd) && fails() ? errno : real(fd, from, size); \
    }
ALLOCATE(posix_fallocate)
ALLOCATE(posix_fallocate64)
#define MAP(name)                                                                              \
    void *name(void *at, size_t size, int protection, int flags, int fd, off_t from)           \
    {                                                                                          \
        REAL(name);                                                                            \
        return mine(fd) && fails() ? MAP_FAILED : real(at, size, protection, flags, fd, from); \
    }
MAP(mmap)
MAP(mmap64)
int mkdir(const char *path, mode_t mode)
{
    REAL(mkdir);
    return concerned(path) && fails() ? -1 : real(path, mode);
}
int rename(const char *from, const char *to)
{
    REAL(rename);
    return concerned(to) && fails() ? -1 : real(from, to);
}
