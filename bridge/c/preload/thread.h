/* thread.h: a thread of a program in bus time: its slot, its waits, and its view of the clock. */
#ifndef PRELOAD_THREAD_H
#define PRELOAD_THREAD_H

#include <stdint.h>
#include <sys/types.h>
#include <time.h>

#include "table.h"

#define EXPORT __attribute__((visibility("default")))
#define SECOND INT64_C(1000000000)

/* The function that would be called without this library; `pointer` keeps it. */
void *real_function(void **pointer, const char *name);
#define REAL(name)             \
    static void *found_##name; \
    __typeof__(name) *real = (__typeof__(name) *)real_function(&found_##name, #name)

/* The table, or null in a process that `cosim bus` has not started. The first call attaches. */
table_t *bus_table(void);
/* Bus time, ns. Reads of the clock without a wait in between let time pass after a while. */
int64_t bus_now(void);
/* A call has found nothing to do and has not waited: counts as a read of the clock. */
void looked_in_vain(void);
/* This thread has got a lock without a wait. CPython reads the clock before: that look does not count. */
void has_a_lock(void);
/* Other threads may be woken by this call: time may no longer pass without the coordinator. */
void wakes_others(void);

/* Deadlines in bus time, ns: NEVER for a null pointer; -1 for an invalid time. */
int64_t deadline_after(const struct timespec *duration);
int64_t deadline_at(clockid_t clock, const struct timespec *when);
int64_t deadline_in_ms(int milliseconds);
struct timespec to_timespec(int64_t ns);
/* The time of a clock of the system in bus time; false: it is not one of those. */
int clock_offset(clockid_t clock, int64_t *offset);

/* Before and after a system call that may wait. `signalled`: a signal has to end it. */
void wait_begins(int64_t deadline, int signalled);
enum turn wait_ends(void);
/* True if the system call was ended by a signal of the coordinator that came late: call it again. */
int woken_in_vain(void);

/* Sleep until `deadline`; 0, or EINTR when a signal of the program came. */
int sleep_until(int64_t deadline);

/* A slot for a thread that is being made. */
slot_t *new_slot(int32_t pid, int32_t tid);
/* The slot of a process that is about to run another program; it is made where there is none. */
slot_t *slot_for_process(int32_t pid);
/* There is no child for the slot that was made for it. */
void fork_has_failed(void);
/* Take a slot for this thread, and wait for the turn. */
void adopt_slot(slot_t *slot);
slot_t *slot_of_process(int32_t pid);
slot_t *own_slot(void);
/* A system call, past the function `syscall` of this library; -1 and errno on failure. */
long kernel(long number, ...);
long raw_futex(uint32_t *word, int operation, uint32_t value, const struct timespec *timeout);

#endif
