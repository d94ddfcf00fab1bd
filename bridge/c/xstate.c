/* xstate.c: lets User-Mode Linux run on a host whose processors have more registers than it supports.
 * LD_PRELOAD puts it before libc's ptrace() (bridge/vcan/uml.py); it has no other use.
 *
 * Debian's (6.1) keeps the extended registers of its processes in 2696 bytes. A host with AMX (Intel,
 * from 2023) takes all 11008 or none, and no process of the guest could begin. So a set that is
 * shorter than the host's is made as long, with what is not in it as it is at first: the guest offers
 * its processes nothing of that, so they have not used it.
 */
#if defined(__linux__) && defined(__x86_64__)
#define _GNU_SOURCE
#include <elf.h>
#include <errno.h>
#include <stdarg.h>
#include <stdint.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/syscall.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

#include "frame.h"

/* HEADER: where the bits of what has been used stand; KNOWN: those that 2696 bytes have room for. */
enum { LARGEST = 16384, HEADER = 512, KNOWN = 0x3FF };

static size_t host_size(pid_t pid)
{
    static size_t size;
    static char state[LARGEST];
    struct iovec all = {state, sizeof state};

    if (!size && syscall(SYS_ptrace, PTRACE_GETREGSET, pid, NT_X86_XSTATE, &all) == 0) size = all.iov_len;
    return size;
}

static long set_registers(pid_t pid, struct iovec *given)
{
    static char state[LARGEST] __attribute__((aligned(64)));
    struct iovec all = {state, host_size(pid)};
    uint64_t used;

    if (given->iov_len >= all.iov_len || given->iov_len < HEADER + sizeof used)
        return syscall(SYS_ptrace, PTRACE_SETREGSET, pid, NT_X86_XSTATE, given);
    memcpy(state, given->iov_base, given->iov_len);
    memcpy(&used, state + HEADER, sizeof used);
    used &= KNOWN;
    memcpy(state + HEADER, &used, sizeof used);
    return syscall(SYS_ptrace, PTRACE_SETREGSET, pid, NT_X86_XSTATE, &all);
}

/* As libc's: what is looked at comes back as the result. */
API long ptrace(enum __ptrace_request request, ...)
{
    const int looks = request == PTRACE_PEEKTEXT || request == PTRACE_PEEKDATA || request == PTRACE_PEEKUSER;
    long result, seen = 0;
    va_list list;

    va_start(list, request);
    const pid_t pid = va_arg(list, pid_t);
    void *const address = va_arg(list, void *);
    void *const data = va_arg(list, void *);
    va_end(list);
    if (request == PTRACE_SETREGSET && address == (void *)NT_X86_XSTATE) return set_registers(pid, data);
    result = syscall(SYS_ptrace, request, pid, address, looks ? (void *)&seen : data);
    if (!looks || result < 0) return result;
    errno = 0;
    return seen;
}
#else
typedef int nothing_to_do_elsewhere_t;
#endif
