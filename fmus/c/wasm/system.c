/* system.c - an FMU has no system: what the C library would ask of it is refused here.
 *
 * So the module imports nothing of WASI. A file cannot be opened, nothing is printed, and the end of the process
 * is the end of the FMU: it logs this, and traps.
 */
#include <stdint.h>
#include <string.h>

__attribute__((import_module("fmi:fmi3/callbacks@3.0.0"), import_name("log-message"))) extern void
log_message(const char *name, size_t n, int32_t status, const char *category, size_t m, const char *message,
            size_t k);

enum { SUCCESS = 0, BAD_DESCRIPTOR = 8, NOT_CAPABLE = 76, FATAL = 4 /* of fmi3Status */ };
typedef int32_t I;
typedef int64_t L;
#define ASKED(name) __imported_wasi_snapshot_preview1_##name
#define ZIG(name) zig_##name /* as the part of the library that is written in Zig calls it */
#define LABEL(name) __asm__(#name "|wasi_snapshot_preview1")
#define REFUSED(name, error, ...)                \
    I ASKED(name)(__VA_ARGS__) { return error; } \
    I ZIG(name)(__VA_ARGS__) LABEL(name);        \
    I ZIG(name)(__VA_ARGS__) { return error; }

static _Noreturn void leave(int32_t code)
{
    char said[64] = "tried to end the process, with exit code ";
    char digits[12];
    size_t at = strlen(said), n = 0;
    for (uint32_t left = (uint32_t)code; n == 0 || left != 0; left /= 10)
        digits[n++] = (char)('0' + left % 10);
    while (n != 0) said[at++] = digits[--n];
    log_message("", 0, FATAL, "logStatusFatal", 14, said, at);
    __builtin_trap();
}
_Noreturn void ASKED(proc_exit)(int32_t code) { leave(code); }
_Noreturn void ZIG(proc_exit)(int32_t code) LABEL(proc_exit);
_Noreturn void ZIG(proc_exit)(int32_t code) { leave(code); }

/* No arguments and no environment. */
static I none(I count, I bytes)
{
    *(uint32_t *)(uintptr_t)count = *(uint32_t *)(uintptr_t)bytes = 0;
    return SUCCESS;
}
I ASKED(environ_sizes_get)(I count, I bytes) { return none(count, bytes); }
I ASKED(args_sizes_get)(I count, I bytes) { return none(count, bytes); }
I ZIG(environ_sizes_get)(I count, I bytes) LABEL(environ_sizes_get);
I ZIG(environ_sizes_get)(I count, I bytes) { return none(count, bytes); }
I ZIG(args_sizes_get)(I count, I bytes) LABEL(args_sizes_get);
I ZIG(args_sizes_get)(I count, I bytes) { return none(count, bytes); }
REFUSED(sched_yield, SUCCESS, void)

/* The functions of WASI preview 1, in its order. */
REFUSED(args_get, SUCCESS, I a, I b)
REFUSED(environ_get, SUCCESS, I a, I b)
REFUSED(clock_res_get, NOT_CAPABLE, I a, I b)
REFUSED(clock_time_get, NOT_CAPABLE, I a, L b, I c)
REFUSED(fd_advise, BAD_DESCRIPTOR, I a, L b, L c, I d)
REFUSED(fd_allocate, BAD_DESCRIPTOR, I a, L b, L c)
REFUSED(fd_close, BAD_DESCRIPTOR, I a)
REFUSED(fd_datasync, BAD_DESCRIPTOR, I a)
REFUSED(fd_fdstat_get, BAD_DESCRIPTOR, I a, I b)
REFUSED(fd_fdstat_set_flags, BAD_DESCRIPTOR, I a, I b)
REFUSED(fd_fdstat_set_rights, BAD_DESCRIPTOR, I a, L b, L c)
REFUSED(fd_filestat_get, BAD_DESCRIPTOR, I a, I b)
REFUSED(fd_filestat_set_size, BAD_DESCRIPTOR, I a, L b)
REFUSED(fd_filestat_set_times, BAD_DESCRIPTOR, I a, L b, L c, I d)
REFUSED(fd_pread, BAD_DESCRIPTOR, I a, I b, I c, L d, I e)
REFUSED(fd_prestat_get, BAD_DESCRIPTOR, I a, I b)
REFUSED(fd_prestat_dir_name, BAD_DESCRIPTOR, I a, I b, I c)
REFUSED(fd_pwrite, BAD_DESCRIPTOR, I a, I b, I c, L d, I e)
REFUSED(fd_read, BAD_DESCRIPTOR, I a, I b, I c, I d)
REFUSED(fd_readdir, BAD_DESCRIPTOR, I a, I b, I c, L d, I e)
REFUSED(fd_renumber, BAD_DESCRIPTOR, I a, I b)
REFUSED(fd_seek, BAD_DESCRIPTOR, I a, L b, I c, I d)
REFUSED(fd_sync, BAD_DESCRIPTOR, I a)
REFUSED(fd_tell, BAD_DESCRIPTOR, I a, I b)
REFUSED(fd_write, BAD_DESCRIPTOR, I a, I b, I c, I d)
REFUSED(path_create_directory, NOT_CAPABLE, I a, I b, I c)
REFUSED(path_filestat_get, NOT_CAPABLE, I a, I b, I c, I d, I e)
REFUSED(path_filestat_set_times, NOT_CAPABLE, I a, I b, I c, I d, L e, L f, I g)
REFUSED(path_link, NOT_CAPABLE, I a, I b, I c, I d, I e, I f, I g)
REFUSED(path_open, NOT_CAPABLE, I a, I b, I c, I d, I e, L f, L g, I h, I i)
REFUSED(path_readlink, NOT_CAPABLE, I a, I b, I c, I d, I e, I f)
REFUSED(path_remove_directory, NOT_CAPABLE, I a, I b, I c)
REFUSED(path_rename, NOT_CAPABLE, I a, I b, I c, I d, I e, I f)
REFUSED(path_symlink, NOT_CAPABLE, I a, I b, I c, I d, I e)
REFUSED(path_unlink_file, NOT_CAPABLE, I a, I b, I c)
REFUSED(poll_oneoff, NOT_CAPABLE, I a, I b, I c, I d)
REFUSED(random_get, NOT_CAPABLE, I a, I b)
REFUSED(sock_accept, NOT_CAPABLE, I a, I b, I c)
REFUSED(sock_recv, NOT_CAPABLE, I a, I b, I c, I d, I e, I f)
REFUSED(sock_send, NOT_CAPABLE, I a, I b, I c, I d, I e)
REFUSED(sock_shutdown, NOT_CAPABLE, I a, I b)
