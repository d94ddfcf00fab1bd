/* programs.c: threads and programs that a program in bus time starts and waits for */
#define _GNU_SOURCE
#include <errno.h>
#include <pthread.h>
#include <signal.h>
#include <spawn.h>
#include <stdarg.h>
#include <stdlib.h>
#include <sys/wait.h>
#include <unistd.h>

#include "thread.h"

extern char **environ;

typedef struct {
    slot_t *slot;
    void *(*routine)(void *);
    void *argument;
} beginning_t;

static void *begin(void *given)
{
    const beginning_t b = *(beginning_t *)given;

    free(given);
    adopt_slot(b.slot);
    return b.routine(b.argument);
}

EXPORT int pthread_create(pthread_t *restrict thread, const pthread_attr_t *restrict attributes,
                          void *(*routine)(void *), void *restrict argument)
{
    REAL(pthread_create);
    beginning_t *b;
    int failed;

    if (own_slot() == NULL || (b = malloc(sizeof *b)) == NULL)
        return real(thread, attributes, routine, argument);
    wakes_others();
    b->slot = new_slot((int32_t)getpid(), 0);
    b->routine = routine;
    b->argument = argument;
    failed = real(thread, attributes, begin, b);
    if (failed) {
        STORE(b->slot->state, FREE);
        free(b);
    }
    return failed;
}

EXPORT pid_t fork(void)
{
    REAL(fork);
    const pid_t pid = real();

    if (pid < 0 && bus_table() != NULL) fork_has_failed();
    return pid;
}

/* This process becomes another program, or the child of a vfork does: time waits until it is there. */
static void before_exec(void)
{
    if (bus_table() == NULL) return;
    wakes_others();
    slot_for_process((int32_t)getpid());
}

EXPORT int execve(const char *path, char *const arguments[], char *const environment[])
{
    REAL(execve);

    before_exec();
    return real(path, arguments, environment);
}

EXPORT int execv(const char *path, char *const arguments[]) { return execve(path, arguments, environ); }

EXPORT int execvpe(const char *file, char *const arguments[], char *const environment[])
{
    REAL(execvpe);

    before_exec();
    return real(file, arguments, environment);
}

EXPORT int execvp(const char *file, char *const arguments[]) { return execvpe(file, arguments, environ); }

static int spawned(int failed, const pid_t *pid)
{
    if (!failed && bus_table() != NULL) slot_for_process((int32_t)*pid);
    return failed;
}

EXPORT int posix_spawn(pid_t *restrict pid, const char *restrict path,
                       const posix_spawn_file_actions_t *actions,
                       const posix_spawnattr_t *restrict attributes, char *const arguments[restrict],
                       char *const environment[restrict])
{
    REAL(posix_spawn);
    pid_t own, *found = pid ? pid : &own;

    return spawned(real(found, path, actions, attributes, arguments, environment), found);
}

EXPORT int posix_spawnp(pid_t *restrict pid, const char *restrict file,
                        const posix_spawn_file_actions_t *actions,
                        const posix_spawnattr_t *restrict attributes, char *const arguments[restrict],
                        char *const environment[restrict])
{
    REAL(posix_spawnp);
    pid_t own, *found = pid ? pid : &own;

    return spawned(real(found, file, actions, attributes, arguments, environment), found);
}

/* As in the C library, whose own function makes a child that this library learns of too late. */
static int run_shell(const char *command)
{
    char *const arguments[] = {(char *)"sh", (char *)"-c", (char *)"--", (char *)command, NULL};
    struct sigaction ignored = {0}, interrupt, quit;
    posix_spawnattr_t attributes;
    sigset_t child, before, usual;
    int failed, status = -1;
    pid_t pid;

    ignored.sa_handler = SIG_IGN;
    sigaction(SIGINT, &ignored, &interrupt);
    sigaction(SIGQUIT, &ignored, &quit);
    sigemptyset(&child);
    sigaddset(&child, SIGCHLD);
    sigprocmask(SIG_BLOCK, &child, &before);
    sigemptyset(&usual);
    if (interrupt.sa_handler != SIG_IGN) sigaddset(&usual, SIGINT);
    if (quit.sa_handler != SIG_IGN) sigaddset(&usual, SIGQUIT);
    posix_spawnattr_init(&attributes);
    posix_spawnattr_setsigmask(&attributes, &before);
    posix_spawnattr_setsigdefault(&attributes, &usual);
    posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETSIGDEF | POSIX_SPAWN_SETSIGMASK);
    failed = posix_spawn(&pid, "/bin/sh", NULL, &attributes, arguments, environ);
    posix_spawnattr_destroy(&attributes);
    if (!failed)
        while (waitpid(pid, &status, 0) < 0 && errno == EINTR) {}
    sigaction(SIGINT, &interrupt, NULL);
    sigaction(SIGQUIT, &quit, NULL);
    sigprocmask(SIG_SETMASK, &before, NULL);
    if (failed) errno = failed;
    return status;
}

EXPORT int system(const char *command)
{
    REAL(system);

    return own_slot() && command ? run_shell(command) : real(command);
}

#define WAITER(type, name, parameters, arguments, at_once) \
    EXPORT type name parameters                            \
    {                                                      \
        REAL(name);                                        \
        type found;                                        \
        if (own_slot() == NULL || (at_once)) {             \
            found = real arguments;                        \
            if (found == 0) looked_in_vain();              \
            return found;                                  \
        }                                                  \
        wait_begins(NEVER, 0);                             \
        found = real arguments;                            \
        wait_ends();                                       \
        return found;                                      \
    }

WAITER(pid_t, wait, (int *status), (status), 0)
WAITER(pid_t, waitpid, (pid_t pid, int *status, int options), (pid, status, options), options &WNOHANG)
WAITER(pid_t, wait3, (int *status, int options, struct rusage *used), (status, options, used),
       options &WNOHANG)
WAITER(pid_t, wait4, (pid_t pid, int *status, int options, struct rusage *used), (pid, status, options, used),
       options &WNOHANG)
WAITER(int, waitid, (idtype_t kind, id_t id, siginfo_t *found_out, int options),
       (kind, id, found_out, options), options &WNOHANG)
