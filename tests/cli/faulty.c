/* faulty.c: loaded before the C library, lets the n-th call on files below a folder fail.
 *
 * FAULT_ROOT: the folder; FAULT_AT: which call, from 1 on; FAULT_ERRNO: how it fails; FAULT_KEEP:
 * if set, all later calls fail too (a full disk). Calls counted: open for writing, write, ftruncate,
 * rename, fallocate and mmap of such a file. With FAULT_AT=0 nothing fails, and the number of calls
 * of each process that ends by exit() is appended to FAULT_COUNT.
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

static int fails(void)
{
    long at = number("FAULT_AT"), n = __atomic_add_fetch(&calls, 1, __ATOMIC_SEQ_CST);
    if (at > 0 && (n == at || (n > at && getenv("FAULT_KEEP")))) {
        errno = (int)number("FAULT_ERRNO");
        return 1;
    }
    return 0;
}

long fault_calls(void) { return __atomic_load_n(&calls, __ATOMIC_SEQ_CST); }

__attribute__((destructor)) static void count(void)
{
    const char *path = getenv("FAULT_COUNT");
    FILE *file = path && calls ? fopen(path, "a") : NULL;
    if (file) {
        fprintf(file, "%ld\n", calls);
        fclose(file);
    }
}

#define REAL(name) __typeof__(&name) real = (__typeof__(&name))dlsym(RTLD_NEXT, #name)

static int opened(int fd, const char *path)
{
    if (fd >= 0 && fd < FILES) below[fd] = (char)concerned(path);
    return fd;
}
static int mine(int fd) { return fd >= 0 && fd < FILES && below[fd]; }

#define OPEN(name) \
    int name(const char *path, int flags, ...) \
    { \
        va_list more; \
        va_start(more, flags); \
        mode_t mode = flags & (O_CREAT | O_TMPFILE) ? va_arg(more, mode_t) : 0; \
        va_end(more); \
        REAL(name); \
        if ((flags & O_ACCMODE) != O_RDONLY && concerned(path) && fails()) return -1; \
        return opened(real(path, flags, mode), path); \
    }
OPEN(open)
OPEN(open64)
#define OPENAT(name) \
    int name(int folder, const char *path, int flags, ...) \
    { \
        va_list more; \
        va_start(more, flags); \
        mode_t mode = flags & (O_CREAT | O_TMPFILE) ? va_arg(more, mode_t) : 0; \
        va_end(more); \
        REAL(name); \
        if ((flags & O_ACCMODE) != O_RDONLY && concerned(path) && fails()) return -1; \
        return opened(real(folder, path, flags, mode), path); \
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
#define TRUNCATE(name) \
    int name(int fd, off_t size) \
    { \
        REAL(name); \
        return mine(fd) && fails() ? -1 : real(fd, size); \
    }
TRUNCATE(ftruncate)
TRUNCATE(ftruncate64)
#define SHORTEN(name) \
    int name(const char *path, off_t size) \
    { \
        REAL(name); \
        return concerned(path) && fails() ? -1 : real(path, size); \
    }
SHORTEN(truncate)
SHORTEN(truncate64)
#define ALLOCATE(name) \
    int name(int fd, off_t from, off_t size) \
    { \
        REAL(name); \
        return mine(fd) && fails() ? errno : real(fd, from, size); \
    }
ALLOCATE(posix_fallocate)
ALLOCATE(posix_fallocate64)
#define MAP(name) \
    void *name(void *at, size_t size, int protection, int flags, int fd, off_t from) \
    { \
        REAL(name); \
        return mine(fd) && fails() ? MAP_FAILED : real(at, size, protection, flags, fd, from); \
    }
MAP(mmap)
MAP(mmap64)
int rename(const char *from, const char *to)
{
    REAL(rename);
    return concerned(to) && fails() ? -1 : real(from, to);
}
