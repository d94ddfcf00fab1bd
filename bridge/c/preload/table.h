/* table.h: memory that the programs in bus time and their coordinator (`cosim bus`) share.
 *
 * Each thread of each program has a slot. A thread that waits writes its deadline there; the coordinator
 * lets time pass when all threads wait, and then gives the turn to one thread after the other, in the order
 * of programs and threads. All fields are read and written by the __atomic functions of the compiler. */
#ifndef PRELOAD_TABLE_H
#define PRELOAD_TABLE_H

#include <stdint.h>

#define SLOTS 1024
#define PROGRAMS 64
#define MAGIC 0x636f7331u
#define NEVER INT64_MAX
/* Sent to a thread whose time-out is over, while it sleeps in the kernel. */
#define WAKE_SIGNAL 61

enum slot_state {
    FREE,     /* no thread */
    STARTING, /* made, and not yet in its own code */
    RUNNING,  /* has the turn, or is in a call that is not covered */
    WAITING,  /* in a call that waits, until `deadline` */
    READY     /* what it waited for has happened; it waits for its turn */
};

enum turn { NO_TURN, GO_ON, TIME_OUT };

typedef struct {
    int32_t state; /* of enum slot_state */
    int32_t turn;  /* of enum turn; the word of a futex */
    int32_t program, number;
    int32_t pid, tid;
    int32_t signalled; /* it sleeps in a call that a signal has to end */
    uint32_t seq;      /* waits so far */
    int64_t deadline;  /* bus time, ns, or NEVER */
} slot_t;

typedef struct {
    uint32_t magic;
    uint32_t bell; /* the word of a futex: a thread has changed its state */
    int32_t lock;
    int32_t coordinator;       /* its process */
    int32_t numbers[PROGRAMS]; /* threads of each program so far */
    int64_t now;               /* bus time, ns */
    int64_t lease;             /* until then the only thread that runs may let time pass by itself, ns */
    int64_t monotonic;         /* CLOCK_MONOTONIC at bus time 0, ns */
    int64_t date;              /* CLOCK_REALTIME at bus time 0, ns */
    int64_t alarms[SLOTS];     /* SIGALRM of the process of this slot, ns, or NEVER */
    int64_t intervals[SLOTS];  /* its period, ns; 0: once */
    slot_t slots[SLOTS];
} table_t;

#define LOAD(x) __atomic_load_n(&(x), __ATOMIC_SEQ_CST)
#define STORE(x, value) __atomic_store_n(&(x), (value), __ATOMIC_SEQ_CST)
#define ADD(x, value) __atomic_add_fetch(&(x), (value), __ATOMIC_SEQ_CST)

#endif
