/* run.c: all of a plan, tick by tick. */
#include "engine_internal.h"

/* Where the segment of an operation ends. */
static int64_t last_of(const engine_t *e, int64_t operation)
{
    const segment_t *x = e->segments;

    while (operation >= x->last) x++;
    return x->last;
}

/* Runs `ticks` ticks; returns RUN_OK or why it stopped. e->tick is then the tick that failed. A tick in
 * which an FMU ends the simulation after its step (RUN_TERMINATED) is done to its end and counted. */
API int32_t engine_run(engine_t *e, int64_t ticks)
{
    const int64_t end = e->tick + ticks;
    failure_t failure = {-1, 0, 0, 0, 0, 0}, ended = {-1, 0, 0, 0, 0, 0};

    const int plain = find_plain(e);

    if (e->team) return run_windows(e, end);
    catch_up(e->segments, e->n_segments, e->tick);
    for (; e->tick < end; e->tick++) {
        const operation_t *op = NULL;
        int result = RUN_OK;
        if (plain) op = run_ticks(e, end, &failure, &result);
        if (op) {
            failure.result = result;
            failure.operation = op - e->operations;
            result = run_operations(e, e->tick, 1, failure.operation, last_of(e, failure.operation), &failure,
                                    &ended);
            if (result == RUN_OK)
                result = run_tick(e, e->tick, 1, e->segments, e->n_segments, &failure, &ended);
        } else {
            if (e->tick == end) break;
            if (*(volatile int32_t *)&e->stop) return RUN_STOPPED;
            result = run_tick(e, e->tick, 1, e->segments, e->n_segments, &failure, &ended);
        }
        if (result != RUN_OK) return keep_failure(e, &failure, result);
        if (ended.operation < 0) continue;
        e->tick++;
        return keep_failure(e, &ended, RUN_TERMINATED);
    }
    return RUN_OK;
}
