/* engine_internal.h: what the units of the engine offer each other, each to those below it in this file.
 *
 * engine.c compiles all of them as one, so that the loop can contain what is common (ENGINE_WHOLE); each can
 * also be compiled by itself.
 */
#ifndef COSIM_ENGINE_INTERNAL_H
#define COSIM_ENGINE_INTERNAL_H

#include "fmu_log.h"
#include "mailbox.h"

#if defined(ENGINE_WHOLE)
#define SHARED static
#define HOT INLINE /* part of the loop */
#else
#define SHARED
#define HOT
#endif

#define SLACK 1e-9               /* of a step: two times closer than this are one */
enum { CALLS_AT_MOST = 100000 }; /* without getting anywhere, within one step */
enum { REFUSED = 2 };            /* fmi2Discard: a trial state that the FMU cannot evaluate */

/* Neither OK nor a warning; this includes values that FMI does not define, such as -1. */
INLINE int failed_call(int status) { return (unsigned)status > 1u; }

/* The time of a tick, s. */
INLINE double time_of(const engine_t *e, int64_t tick) { return e->start + (double)tick * e->h; }

/* A step being done: what everything in it needs. */
typedef struct {
    unit_t *unit;
    double *signals;
    int *status;
    int32_t *failed;
    double now; /* s: of a partition that is active, or the start of the step */
    int result; /* of call-backs: RUN_..., and then the status of the call that failed in one */
    int refused;
} doing_t;

/* What fmi3DoStep returns besides its status. */
typedef struct {
    _Bool event, terminate, early;
    double reached;
} outcome_t;

/* A step of an FMU for model exchange; every function returns RUN_..., and a status that is not OK in *status. */
typedef struct {
    unit_t *unit;
    exchange_t *x;
    void *fmu;
    double *signals;
    int *status;
    int32_t *failed;
} exchanging_t;

/* The vectors of a group with macro steps. */
typedef struct {
    double *inputs, *held, *start, *first, *last, *end, *largest;
} macro_memory_t;

/* fmu_log.c */
SHARED log_t *own_log(void *environment);

/* numbers.c */
SHARED NOINLINE int any_not_finite(const double *x, int64_t n);
HOT int not_finite(const double *x, int64_t n);
SHARED NOINLINE void copy_many(double *target, const double *source, int64_t n);
HOT void copy(double *target, const double *source, int64_t n);

/* typed_values.c */
SHARED int call_access(const access_t *a, void *instance);
SHARED int set_typed(const access_t *a, int64_t n, void *instance, const double *s, int *status,
                     int32_t *failed);
SHARED int get_typed(const access_t *a, int64_t n, void *instance, double *s, int *status, int32_t *failed);

/* clocks.c */
SHARED int is_due(ticker_t *c, int64_t hit, double now, const double *s);
SHARED int wake(const doing_t *d, int64_t hit, double now);
SHARED int tick_clocks(const doing_t *d, double now);
SHARED int ask_interval(const doing_t *d, ticker_t *c, double now);
SHARED int ask_intervals(const doing_t *d, double now, _Bool *again);
SHARED double next_time(const typed_t *x);
SHARED int feed_partitions(const doing_t *d);
SHARED int ask_clocks(const doing_t *d);
SHARED int take_partitions(const doing_t *d);
SHARED int exchange_clocked(const doing_t *d);

/* events.c */
SHARED void note_event(const typed_t *x, double now);
SHARED int changed(const access_t *a, int64_t n, const double *s);
SHARED int input_event(const doing_t *d, int64_t hit, double t);
SHARED int refused_inside(const doing_t *d);
SHARED int do_step(doing_t *d, double t);
SHARED NOINLINE int finish_step(doing_t *d, double t, const outcome_t *a);

/* scheduled.c */
SHARED int step_scheduled(doing_t *d, double t);

/* typed_steps.c */
SHARED NOINLINE int step_typed(unit_t *u, double *s, double t, int64_t hit, int *status, int32_t *failed);

/* exchange_calls.c */
enum { START, END, TRIAL, STAGES };  /* vectors of states */
enum { BEFORE, AFTER, LEFT, TRIED }; /* vectors of indicators */
typedef int (*get_numbers_t)(void *, double *, size_t);
SHARED double *states(const exchange_t *x, int which);
SHARED double *indicators(const exchange_t *x, int which);
SHARED double time_resolution(double a, double b);
SHARED int did(const exchanging_t *d, int status, int result);
SHARED int put_states(const exchanging_t *d, double t, const double *y);
SHARED int derive(const exchanging_t *d, double t, const double *y, double *rates);
SHARED int indicate(const exchanging_t *d, double *z);

/* cvode.c */
SHARED int cvode_restart(const exchanging_t *d);
SHARED int cvode_step(const exchanging_t *d, double bound, double *end);
SHARED int cvode_dense(const exchanging_t *d, double t, double *y);
SHARED int cvode_tolerances(const exchanging_t *d);

/* solvers.c */
SHARED int solver_restart(const exchanging_t *d);
SHARED int solver_step(const exchanging_t *d, double bound, double *end);
SHARED int interpolate(const exchanging_t *d, double t, double end, double *y);

/* model_exchange.c */
SHARED NOINLINE int step_exchange(unit_t *u, double *s, double t, int *status, int32_t *failed);

/* fmi_steps.c */
HOT int set_inputs(const unit_t *u, int32_t kind, int plain, const double *s);
HOT int step_plain_typed(unit_t *u, double *s, int64_t tick, double t, int *status, int32_t *signal);
HOT int step_each(int32_t kind, unit_t **at, const unit_t *last, double *s, double t, int *status,
                  int32_t *signal);
HOT int step_from(const engine_t *e, int64_t tick, double t, int32_t index, failure_t *failure);
HOT int step_unit(const engine_t *e, int64_t tick, int32_t index, failure_t *failure);
HOT int take_outputs(const engine_t *e, int32_t index, int status, failure_t *failure);

/* steps_at_once.c */
SHARED NOINLINE int step_often(const engine_t *e, int64_t tick, int64_t *ticks, const operation_t *op,
                               failure_t *failure);
SHARED int step_units(const engine_t *e, int64_t tick, const operation_t *op, failure_t *failure);

/* rollback.c */
SHARED macro_memory_t memory_of(const macro_t *m);
SHARED int move_state(const engine_t *e, rollback_t *r, int what, failure_t *failure);
SHARED int move_states(const engine_t *e, macro_t *m, int what, int coupled, failure_t *failure);

/* direct_outputs.c */
enum { CONVERGED_TENTHS = 1 }; /* of a tolerance: what is closer is the same */
SHARED int finish_outputs(engine_t *e, macro_t *m, int64_t tick, double t, double h, const double *guess,
                          failure_t *failure);

/* macro_steps.c */
SHARED NOINLINE int run_macro(engine_t *e, int64_t tick, macro_t *m, failure_t *failure);

/* plain_steps.c */
HOT void push(sender_t *l, const operation_t *op, const double *value);
HOT int pull(link_t *l, double *target);
HOT int play(player_t *p, double *target);
HOT void record(engine_t *e, int64_t tick, const operation_t *op);
SHARED int find_plain(engine_t *e);
SHARED NOINLINE const operation_t *run_plain(engine_t *e, int64_t tick, const operation_t *op,
                                             const operation_t *end, failure_t *failure, int *result);
SHARED NOINLINE const operation_t *run_ticks(engine_t *e, int64_t end, failure_t *failure, int *result);

/* operations.c */
HOT int run_operation(engine_t *e, int64_t tick, double *s, const operation_t *op, failure_t *failure);
HOT int run_tick(engine_t *e, int64_t tick, int64_t ticks, segment_t *segments, int64_t n_segments,
                 failure_t *failure, failure_t *ended);
HOT int run_operations(engine_t *e, int64_t tick, int64_t ticks, int64_t first, int64_t last,
                       failure_t *failure, failure_t *ended);
HOT void catch_up(segment_t *segments, int64_t n_segments, int64_t tick);
SHARED NOINLINE int32_t keep_failure(engine_t *e, const failure_t *f, int32_t result);

/* partitions.c */
SHARED int32_t run_windows(engine_t *e, int64_t end);

#endif
