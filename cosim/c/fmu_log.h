/* fmu_log.h: what an FMU logs: a ring of the last lines, and as much text as there is room behind it. */
#ifndef COSIM_FMU_LOG_H
#define COSIM_FMU_LOG_H

#include "engine.h"

enum { LOG_LINES = 32, LOG_WIDTH = 512 };

typedef struct {
    int64_t count;
    int64_t capacity, used, dropped; /* bytes of text that follows, bytes filled, lines left out */
    int32_t level[LOG_LINES];
    char line[LOG_LINES][LOG_WIDTH];
    void *step; /* the step being done (doing_t), for other call-backs */
} log_t;

#endif
