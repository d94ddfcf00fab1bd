/* fmu_log.h: what an FMU logs: a ring of the last lines, and as much text as there is room behind it.
 *
 * Part of engine.c. C fills it, since FMI 2.0's loggers are variadic.
 */

enum { LOG_LINES = 32, LOG_WIDTH = 512 };

typedef struct {
    int64_t count;
    int64_t capacity, used, dropped; /* bytes of text that follows, bytes filled, lines left out */
    int32_t level[LOG_LINES];
    char line[LOG_LINES][LOG_WIDTH];
    void *step;                      /* the step being done (doing_t), for other call-backs */
} log_t;

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

API void engine_log2(void *environment, const char *instance, int status, const char *category,
                     const char *format, ...)
{
    char text[LOG_WIDTH];
    va_list arguments;
    (void)instance;
    if (!environment) return;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format ? format : "", arguments);
    va_end(arguments);
    log_line(environment, status, category, text);
}

/* FMI 1.0 passes no environment to its logger: instances are known by their names. Loggers of the same
 * name go to the one that was opened last. */
enum { NAMED_LOGS = 256 };

static struct {
    const char *name;
    log_t *log;
} named_logs[NAMED_LOGS];

API void engine_log1_open(const char *name, log_t *log)
{
    for (int i = 0; i < NAMED_LOGS; i++) {
        if (named_logs[i].log) continue;
        named_logs[i].name = name;
        named_logs[i].log = log;
        return;
    }
}

API void engine_log1_close(const log_t *log)
{
    for (int i = 0; i < NAMED_LOGS; i++)
        if (named_logs[i].log == log) named_logs[i].log = NULL;
}

API void engine_log1(void *component, const char *instance, int status, const char *category,
                     const char *format, ...)
{
    char text[LOG_WIDTH];
    va_list arguments;
    (void)component;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format ? format : "", arguments);
    va_end(arguments);
    for (int i = NAMED_LOGS - 1; instance && i >= 0; i--) {
        if (!named_logs[i].log || strcmp(named_logs[i].name, instance)) continue;
        log_line(named_logs[i].log, status, category, text);
        return;
    }
}

API void engine_log3(void *environment, int status, const char *category, const char *message)
{
    if (environment) log_line(environment, status, category, message ? message : "");
}
