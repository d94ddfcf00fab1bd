/* fmu_log.c: see fmu_log.h. C fills the logs, since FMI 2.0's loggers are variadic. */
#include "engine_internal.h"

#include <stdlib.h>

static void log_line(log_t *log, int level, const char *category, const char *text)
{
    static const char *const levels[] = {"ok", "warning", "discard", "error", "fatal", "pending"};
    const int64_t i = log->count++ % LOG_LINES, room = log->capacity - log->used;
    const char *name = level >= 0 && level < 6 ? levels[level] : "unknown";
    char *target = (char *)(log + 1) + log->used;
    int n;

    log->level[i] = level;
    snprintf(log->line[i], LOG_WIDTH, "%s", text);
    if (!log->capacity) return;
    n = snprintf(target, (size_t)room, "[%s] %s: %s\n", name, category ? category : "", text);
    if (n >= 0 && n < room) log->used += n;
    else log->dropped++;
}

/* The logs that are open, by address, with the name of the instance that each belongs to. Some FMUs call
 * back with another environment than they were given: nothing is read through a pointer that is not
 * here. Closed ones stay until they are more than half. */
typedef struct {
    log_t *log;
    const char *name;
    int64_t serial; /* counts; 0: closed */
} open_log_t;

static struct {
    open_log_t *logs;
    int64_t n, room, closed, serial;
    char locked;
} opened;

static void lock_logs(void)
{
    while (__atomic_test_and_set(&opened.locked, __ATOMIC_ACQUIRE)) {}
}

static void unlock_logs(void) { __atomic_clear(&opened.locked, __ATOMIC_RELEASE); }

/* The first of the logs that is not before an address. */
static int64_t log_place(const void *log)
{
    int64_t low = 0, high = opened.n;
    while (low < high) {
        const int64_t middle = (low + high) / 2;
        if ((uintptr_t)opened.logs[middle].log < (uintptr_t)log) low = middle + 1;
        else high = middle;
    }
    return low;
}

static open_log_t *open_log(const void *log)
{
    const int64_t i = log_place(log);
    return i < opened.n && opened.logs[i].log == log ? opened.logs + i : NULL;
}

static void drop_closed(void)
{
    int64_t kept = 0;
    for (int64_t i = 0; i < opened.n; i++)
        if (opened.logs[i].serial) opened.logs[kept++] = opened.logs[i];
    opened.n = kept;
    opened.closed = 0;
}

/* Room for one more; 0: there is no memory. */
static int log_room(void)
{
    const int64_t room = opened.room ? 2 * opened.room : 64;
    open_log_t *logs;
    if (2 * opened.closed > opened.n) drop_closed();
    if (opened.n < opened.room) return 1;
    logs = realloc(opened.logs, (size_t)room * sizeof *logs);
    if (!logs) return 0;
    opened.logs = logs;
    opened.room = room;
    return 1;
}

/* `name` must stay where it is until the log is closed. Returns 0 where there is no memory. */
API int32_t engine_log_open(const char *name, log_t *log)
{
    open_log_t *found;
    int32_t done = 1;
    lock_logs();
    found = open_log(log);
    if (found) opened.closed -= !found->serial;
    else if ((done = log_room()) != 0) {
        const int64_t i = log_place(log);
        found = opened.logs + i;
        memmove(found + 1, found, (size_t)(opened.n++ - i) * sizeof *found);
    }
    if (found) *found = (open_log_t){log, name, ++opened.serial};
    unlock_logs();
    return done;
}

API void engine_log_close(const log_t *log)
{
    open_log_t *found;
    lock_logs();
    found = open_log(log);
    if (found && found->serial) {
        found->serial = 0;
        opened.closed++;
    }
    unlock_logs();
}

/* The log that an environment is; NULL: it is none of ours. */
SHARED log_t *own_log(void *environment)
{
    open_log_t *found;
    log_t *log;
    if (!environment) return NULL;
    lock_logs();
    found = open_log(environment);
    log = found && found->serial ? found->log : NULL;
    unlock_logs();
    return log;
}

/* The log of an instance by its name (the last one of that name), or the only one that is open. */
static log_t *log_of(const char *instance)
{
    open_log_t *only = NULL, *named = NULL;
    log_t *log;
    lock_logs();
    for (int64_t i = 0; i < opened.n; i++) {
        open_log_t *found = opened.logs + i;
        if (!found->serial) continue;
        only = found;
        if (instance && !strcmp(found->name, instance) && (!named || named->serial < found->serial))
            named = found;
    }
    if (!named && only && opened.n - opened.closed == 1) named = only;
    log = named ? named->log : NULL;
    unlock_logs();
    return log;
}

static void log_written(log_t *log, int status, const char *category, const char *format, va_list arguments)
{
    char text[LOG_WIDTH];
    vsnprintf(text, sizeof text, format ? format : "", arguments);
    if (log) log_line(log, status, category, text);
}

API void engine_log2(void *environment, const char *instance, int status, const char *category,
                     const char *format, ...)
{
    log_t *log = own_log(environment);
    va_list arguments;
    va_start(arguments, format);
    log_written(log ? log : log_of(instance), status, category, format, arguments);
    va_end(arguments);
}

/* FMI 1.0 passes no environment to its logger: instances are known by their names. */
API void engine_log1(void *component, const char *instance, int status, const char *category,
                     const char *format, ...)
{
    va_list arguments;
    (void)component;
    va_start(arguments, format);
    log_written(log_of(instance), status, category, format, arguments);
    va_end(arguments);
}

API void engine_log3(void *environment, int status, const char *category, const char *message)
{
    log_t *log = own_log(environment);
    if (!log) log = log_of(NULL);
    if (log) log_line(log, status, category, message ? message : "");
}
