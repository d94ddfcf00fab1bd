/* engine.h: what a plan is in memory, and what engine.c has of FMI. Python has it in
 * cosim/native/structs.py and enums.py, which a build makes from here. */
#ifndef COSIM_ENGINE_H
#define COSIM_ENGINE_H

#include <float.h>
#include <math.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#if defined(_WIN32)
#define API __declspec(dllexport)
#else
#define API __attribute__((visibility("default")))
#endif

/* The common steps are part of the loop, though a lonely FMU's process calls them as well; what is
 * rare is not. */
#if defined(__GNUC__)
#define INLINE static inline __attribute__((always_inline))
#define NOINLINE __attribute__((noinline))
#else
#define INLINE static inline
#define NOINLINE
#endif

/* Store a count after everything that was written before it. */
INLINE void publish(int64_t *place, int64_t count)
{
#if defined(__GNUC__)
    __atomic_store_n(place, count, __ATOMIC_RELEASE);
#else
    *(volatile int64_t *)place = count;
#endif
}

/* What was stored by `publish`. */
INLINE int64_t published(const int64_t *place)
{
#if defined(__GNUC__)
    return __atomic_load_n(place, __ATOMIC_ACQUIRE);
#else
    return *(const volatile int64_t *)place;
#endif
}

enum code {
    OP_COPY,
    OP_SCALE,
    OP_PUSH,
    OP_PULL,
    OP_STEP,
    OP_RECORD,
    OP_AGE,
    OP_PLAY,
    OP_AHEAD,
    OP_BETWEEN,
    OP_GATE,
    OP_SLOPE_AHEAD,
    OP_SLOPE_BETWEEN,
    OP_MACRO
}; /* components that are stepped together, with an error control */
enum unit_kind {
    UNIT_CALL = 0,
    UNIT_NATIVE = 1,
    UNIT_FMI2 = 2,
    UNIT_FMI3 = 3,
    UNIT_TYPED = 4,
    UNIT_EXCHANGE = 5, /* an FMU for model exchange, integrated here */
    UNIT_REMOTE = 6,   /* an FMU in a process of its own, see mailbox.h */
    UNIT_DIRECT = 7    /* of `plain`: UNIT_TYPED, and direct */
};
enum engine_result {
    RUN_OK,
    RUN_STOPPED,
    RUN_STEP,
    RUN_SET,
    RUN_GET,
    RUN_NOT_FINITE,
    RUN_HISTORY,
    RUN_TERMINATED,
    RUN_EARLY_RETURN,
    RUN_VALUE,
    RUN_EVENT,
    RUN_STUCK,
    RUN_GATE,
    RUN_INTERVAL,
    RUN_ENDED,  /* an FMU ended the simulation before its step */
    RUN_SOLVER, /* CVODE failed; the status is its own */
    RUN_LOST,   /* the process of an FMU does not answer; the status is LOST_... */
    RUN_STATE,  /* a state could not be saved, or not be restored */
    RUN_LOOP
}; /* outputs that depend on each other at once do not agree */
enum state_move { MOVE_SAVE, MOVE_BACK, MOVE_SAVE_END, MOVE_BACK_END };
enum output_role {
    ROLE_COUNTED,
    ROLE_DIRECT,
    ROLE_HELD
}; /* of an output in macro steps, see direct_outputs.c */
enum {
    TYPE_F64,
    TYPE_F32,
    TYPE_I8,
    TYPE_U8,
    TYPE_I16,
    TYPE_U16,
    TYPE_I32,
    TYPE_U32,
    TYPE_I64,
    TYPE_U64,
    TYPE_BOOL2,
    TYPE_BOOL3
};
enum solver_kind { SOLVER_EULER, SOLVER_HEUN, SOLVER_RK4, SOLVER_CVODE };
enum clock_kind { CLOCK_PERIODIC, CLOCK_CHANGING, CLOCK_COUNTDOWN, CLOCK_WIRED };

typedef struct {
    int32_t code;
    int32_t index;          /* of the unit, link or columns; of what was there last time, in signals */
    int64_t period;         /* ticks */
    int64_t source, target; /* into signals */
    int64_t count;          /* signals; OP_RECORD: 1, the row is complete with it, else 0; OP_STEP: how
                             * many more of those behind it are done at once with it, or in one loop */
    double gain, offset;
} operation_t;

/* Consecutive operations that are due at the same ticks. */
typedef struct {
    int64_t period, next; /* ticks */
    int64_t first, last;  /* operations; `last` is behind them */
} segment_t;

/* Consecutive entries of a recorded row, and where they are in the signals. `late`: what writes them
 * comes after OP_RECORD in a tick, else 0. */
typedef struct {
    int64_t place, source, count;
    int32_t late, reserved;
} stretch_t;

/* What an OP_RECORD takes: all that is recorded, or what one part has of it. */
typedef struct {
    const stretch_t *stretches;
    int64_t n_stretches;
} columns_t;

typedef int32_t (*call_t)(int32_t unit, double t, double h); /* returns RUN_... */
typedef int32_t (*saving_t)(int32_t unit, int32_t what);     /* MOVE_...; not 0: it failed */
typedef int (*state_t)(void *, void *);
/* A step from t (s) of length h (s): it reads the inputs and writes the outputs; not 0: it failed. */
typedef int32_t (*native_t)(void *instance, double t, double h, const double *inputs, double *outputs);
typedef int (*set2_t)(void *, const uint32_t *, size_t, const double *);
typedef int (*get2_t)(void *, const uint32_t *, size_t, double *);
typedef int (*step2_t)(void *, double, double, int);
typedef int (*set3_t)(void *, const uint32_t *, size_t, const double *, size_t);
typedef int (*get3_t)(void *, const uint32_t *, size_t, double *, size_t);
typedef int (*step3_t)(void *, double, double, _Bool, _Bool *, _Bool *, _Bool *, double *);

/* Not of FMI: steps of n instances of one FMU from times t[0], ... t[m - 1] (s), each up to the first that fails; the status of
 * each, and how many it has made. Outputs of a step that does not fail are finite. */
typedef void (*steps_t)(void *const *instances, size_t n, const double *t, size_t m, double h, int *status,
                        size_t *made);

typedef int (*access2_t)(void *, const uint32_t *, size_t, void *);
typedef int (*access3_t)(void *, const uint32_t *, size_t, void *, size_t);
typedef int (*mode_t3)(void *);
typedef int (*update_t)(void *, _Bool *, _Bool *, _Bool *, _Bool *, _Bool *, double *);
typedef int (*set_clock_t3)(void *, const uint32_t *, size_t, const _Bool *);
typedef int (*get_clock_t3)(void *, const uint32_t *, size_t, _Bool *);
typedef int (*get_interval_t3)(void *, const uint32_t *, size_t, double *, int *);
typedef int (*get_fraction_t3)(void *, const uint32_t *, size_t, uint64_t *, uint64_t *, int *);
typedef int (*activate_t3)(void *, uint32_t, double);
typedef int (*slopes2_t)(void *, const uint32_t *, size_t, const int32_t *, const double *);

/* All variables of one FMI type: one call moves them, by way of a buffer of that type. */
typedef struct {
    void *call;
    const uint32_t *references;
    const int64_t *places; /* into signals, one a scalar */
    void *buffer;
    double *held; /* what was set last, where only changes are; else NULL */
    int64_t n_references, count;
    int32_t type, fmi;
} access_t;

/* An input clock: what ticks it depends on its kind. */
typedef struct {
    uint32_t reference;
    int32_t kind;
    int64_t period, shift;     /* periodic: every `period` steps of its FMU, first in step `shift` */
    double next;               /* s; changing, counting down, or in scheduled execution: its next tick */
    int64_t place;             /* wired: it ticks when the signal there is more than it was, */
    double held;               /* which was this */
    double interval, offset;   /* s; scheduled, periodic: tick n is n intervals after the offset, */
    int64_t counter;           /* or, with a resolution, this many more of it each time */
    int64_t count, resolution; /* the next tick, from `origin` on: exactly count / resolution */
    double origin, due;        /* s; due: when it ticked, or should have */
    double last;               /* s; scheduled: its last activation */
    int64_t n;                 /* scheduled, periodic: its next tick */
    int32_t exact, reserved;   /* exact: the FMU is asked for fractions */
} ticker_t;

/* A clock the FMU ticks itself; `clocks`: those it belongs to, as indices of typed_t's `active`. */
typedef struct {
    uint32_t reference;
    int32_t n_clocks;
    const int32_t *clocks;
    int64_t place; /* into signals: how often it has ticked */
} triggered_t;

/* Variables of the same clocks: set and got while one of them is active. */
typedef struct {
    const access_t *inputs, *outputs;
    const int32_t *clocks;  /* indices of `active` */
    int32_t (*texts)(void); /* takes the texts among the outputs, not 0: it could not; or NULL */
    int64_t n_inputs, n_outputs;
    int32_t n_clocks, fed; /* fed: its inputs were set in this instant */
} partition_t;

/* When an FMU was in Event Mode, s: the first `room` times of `count`. */
typedef struct {
    double *times;
    int64_t count, room;
} event_times_t;

/* An FMU with other types than float64, with event mode, with slopes of inputs, or all of it. */
typedef struct {
    const access_t *inputs, *outputs;
    const access_t *discrete; /* inputs set in Event Mode, on change */
    ticker_t *clocks;
    const triggered_t *triggered;
    partition_t *partitions;
    _Bool *active;          /* which tick now: of `clocks`, then of `triggered` */
    const access_t *slopes; /* or NULL */
    const int32_t *orders;  /* of `slopes`, FMI 2.0: all 1 */
    const int64_t *starts;  /* of `slopes`: where the inputs are, which these are the slopes of */
    const int32_t *stop;    /* set if a step shall return as early as it can; or NULL */
    void *enter_event, *update, *enter_step, *set_clock, *get_clock; /* NULL: no event mode */
    void *get_interval, *get_fraction; /* of clocks that are changing or count down */
    void *activate;                    /* NULL: not in scheduled execution */
    void *log;                         /* log_t, the environment of call-backs */
    event_times_t *happened;           /* or NULL */
    int64_t n_inputs, n_outputs, n_discrete, n_clocks, n_triggered, n_partitions;
    double next_event;     /* s, the time event it announced, or infinity */
    double latest;         /* s, the most that a clock ticked after its time, */
    int64_t late;          /* and how often one did: within a step that could not be cut */
    int32_t fmi, variable; /* variable: steps may be cut at that time */
    int32_t asks, unused;  /* whether there are clocks that are changing or count down */
} typed_t;

/* An FMU for model exchange: its functions, its solver, and how far it is. */
typedef struct {
    void *set_time, *set_states, *get_states, *derivatives, *indicators, *nominals;
    void *completed, *enter_event, *update, *enter_continuous; /* completed: NULL, not needed */
    void *directional;                                         /* or NULL: CVODE takes differences */
    const uint32_t *states, *rates; /* value references of states and of their derivatives */
    double *memory;                 /* seven vectors of states, then four of indicators */
    int64_t n_states, n_indicators, n_references;
    double longest;                     /* s, the most one step of the solver takes */
    double now, next_event;             /* s; next_event: infinity without one */
    int64_t steps, evaluations, events; /* so far */
    int32_t fmi, solver, fresh, status;
    void *cvode, *vector; /* of SUNDIALS: its memory, and the vector of states */
    void *advance, *restart, *stop_time, *dense, *tolerances, *data, *column;
    void *absolute;   /* vector: absolute tolerances */
    double tolerance; /* relative */
    void *current;    /* the step being done, while CVODE calls back */
} exchange_t;

enum { AT_ONCE = 8 };        /* units that are stepped together, at most */
enum { STEPS_AT_ONCE = 64 }; /* steps in a call of an FMU, at most; as many as ticks in a window */

typedef struct {
    int32_t kind, lag; /* lag: ticks from the start of the interval to the tick of the step */
    double h;          /* s, length of a step */
    void *instance;
    void *set, *step, *get;           /* FMI functions, or in `step` the call-back or native_t */
    const uint32_t *inputs, *outputs; /* value references */
    int64_t n_inputs, n_outputs;      /* value references */
    int64_t input, input_count;       /* signals */
    int64_t output, output_count;
    typed_t *typed;
    int64_t period; /* ticks */
    double reached; /* s, where the FMU was when it ended the simulation */
    exchange_t *exchange;
    void *steps;     /* of UNIT_FMI2, UNIT_FMI3: steps_t, or NULL; of UNIT_REMOTE: not NULL */
    double *values;  /* its values, which `inputs` and `outputs` then number; or NULL */
    int32_t repeats; /* its steps may be done again: it must be able to go back */
    int32_t in_rows; /* these values follow each other: those of `inputs`, and those of `outputs` */
    int32_t plain;   /* its kind, if it is called through FMI only and its step begins at its tick; else 0 */
    int32_t direct;  /* of UNIT_TYPED: it has float64 values, events and early return, nothing else */
} unit_t;

/* Memory of the engine that is part of the state of a unit; `size` in bytes. */
typedef struct {
    void *place;
    int64_t size;
} block_t;

/* A unit that can go back to where a step began, or ended. */
typedef struct {
    void *save, *restore;  /* FMI functions, or NULL */
    void *call;            /* without them: saving_t */
    void *states[2];       /* the FMU's at the start and at the end, once they have been saved */
    const block_t *blocks; /* what else is part of them, */
    char *copies[2];       /* and what this was */
    const uint8_t *roles;  /* of its outputs: ROLE_... */
    int64_t n_blocks;
    int64_t first;         /* of its outputs in the vectors of its group */
    int64_t wire, n_wires; /* of its group, that feed it, */
    int64_t input;         /* and where these inputs are in the vectors */
    int32_t unit;
    int32_t coupled; /* it has inputs from the others */
    int32_t ended;   /* it ended the simulation in the last step */
    int32_t reserved;
} rollback_t;

/* A pair of wires between two components: power flows from the one to the other and is the product of
 * effort and flow, which are lists of `count` signals. */
typedef struct {
    int64_t effort, effort_input;     /* output of the first component, input of the second */
    int64_t flow, flow_input;         /* output of the second, input of the first */
    int64_t effort_start, flow_start; /* into the outputs at the start of a macro step */
    int64_t count, residual;          /* residual: into signals, energy that the coupling has made */
    double effort_gain, flow_gain;    /* of the two wires */
    double total, largest;            /* of all periods; of one, its magnitude */
} bond_t;

/* Components of a group whose outputs with direct feed-through wait for each other. */
typedef struct {
    const int32_t *members; /* where they begin in `direct` of the group */
    const int64_t *outputs; /* into signals: first those that a component before theirs takes, or theirs */
    const int64_t *places;  /* the same in the vectors of the group */
    double *memory;         /* see direct_outputs.c */
    int64_t n_members, n_outputs, n_fed_back;
    int64_t n_kept, kept;   /* passes that are remembered: at most, and now */
    int64_t solved, passes; /* of the run */
    double left;            /* the last change, in tolerances */
} loop_t;

enum { MACRO_LEVELS = 31, LOOP_PASSES = 100 };

/* Components that exchange values several times in each of their periods, as often as a tolerance needs. */
typedef struct {
    rollback_t *members;
    const operation_t *wires; /* among them; `index`: 1, the value is held */
    bond_t *bonds;
    double *memory; /* vectors: inputs at the start, and in a step; outputs at the start, after the first
                             * sweep, after the one before the last, at the end of a step, and their largest values */
    const int32_t *direct; /* members with direct feed-through, in the order of their wires */
    loop_t *loops;         /* among them, in their order */
    int64_t n_loops, n_direct, n_members, n_wires, n_bonds, n_inputs, n_outputs;
    int64_t period;                  /* ticks */
    int64_t steps, rejections, size; /* into signals: of the last period; the least size, s */
    double tolerance, absolute;
    double error;               /* of the last step, in tolerances; of `error_level` */
    int32_t level, error_level; /* a step is the period divided by 2 to the level */
    int32_t halvings;           /* the highest level */
    int32_t iterations;         /* sweeps after the first one, at most */
    int32_t repeated;           /* the last step was done again: the next one is no longer */
    int32_t reserved;
    int64_t accepted[MACRO_LEVELS], rejected[MACRO_LEVELS];
    int64_t forced;   /* steps of the least size, accepted with a larger error */
    double worst;     /* the largest error of an accepted step, in tolerances */
    double forced_at; /* s, the first of the forced ones */
} macro_t;

/* The sender's side of a link. What its receiver writes is elsewhere: another thread may do so. */
typedef struct {
    double *history; /* capacity rows of `width`, in the receiver's unit */
    int64_t width, sent;
    int64_t capacity; /* a power of two */
} sender_t;

typedef struct {
    const sender_t *sender;
    const int32_t *table;  /* held sample at each hit of the receiver, for this chunk */
    const double *initial; /* pre-history */
    int64_t row, rows, held;
    int64_t before; /* samples sent before this began: it holds none of them */
} link_t;

typedef struct {
    const double *values; /* one a hit of the receiver, for this chunk */
    int64_t row, rows;
} player_t;

/* Where signals leave the plan or enter it; what happens there is not the engine's business. */
typedef struct {
    int32_t (*passing)(void *context, int64_t tick, double *signals); /* not 0: the run stops */
    void *context;
} gate_t;

/* Why an operation did not go well, and in which tick; `operation`: which, -1: all did. */
typedef struct {
    int64_t operation, tick;
    int32_t result, index, status, signal;
} failure_t;

/* Memory that a part uses; where its end is may be a guess. */
typedef struct {
    const char *first;
    int64_t size; /* bytes */
} span_t;

/* A link by which a part receives. */
typedef struct {
    int32_t link, period; /* ticks from one row of its table to the next */
} received_t;

/* Components that the others reach over links only, or also by wires whose values are taken in the first
 * stage of a tick and computed in the second one. `tick`: the next one to run. */
typedef struct {
    segment_t *segments;
    int64_t n_segments, tick;
    int64_t n_first; /* segments in the first stage */
    const received_t *links;
    int64_t n_links;
    const span_t *spans;
    int64_t n_spans;
} part_t;

/* A thread's own share of a window, in cache lines of its own: the ticket of its chunks; which of its
 * operations failed first, and which ended the simulation. */
typedef struct {
    uint64_t ticket;
    failure_t failed, ended;
    int64_t unused[5];
} member_t;

/* Parts, and the threads that run them, see partitions.c. */
typedef struct {
    uint64_t finished;       /* chunks of this window */
    int64_t limit;           /* the tick at which this window ends */
    part_t *parts;           /* with operations of their own, behind those of the plan */
    const int64_t *places;   /* of those: which operation of the plan each is */
    member_t *members;       /* one a thread */
    int64_t n_parts, n_plan; /* n_plan: operations of the plan */
    int64_t record;          /* which of them is OP_RECORD */
    int64_t longest;         /* ticks of a window */
    int32_t threads, quit;
    int32_t first;  /* the first part for all; those before it are the caller's: 0 or 1 */
    int32_t staged; /* windows are one tick in two stages, else 0 */
    int32_t stage;  /* the one that runs now: 0 or 1 */
    int32_t stride; /* ticks from one multiple of it to the next can be run as one: within them
                             * only units with a period of a tick step, and none of their inputs changes */
} team_t;

typedef struct {
    operation_t *operations;
    segment_t *segments;
    team_t *team; /* NULL: all components together, tick by tick */
    unit_t *units;
    link_t *links;
    sender_t *senders; /* one a link */
    player_t *players;
    gate_t *gates;
    macro_t *macros;
    double *signals;
    double *record;           /* rows of `width`, or NULL */
    const columns_t *columns; /* what is recorded; then, what each part has of it */
    int64_t *recorded;        /* the number of rows in `record`, for concurrent readers; NULL */
    int64_t n_segments, width;
    int64_t row, tick;
    int64_t failed_tick;
    int64_t every;   /* ticks between two rows that are recorded; the others are only counted */
    double h, start; /* s, of a step; the time of tick 0 */
    int32_t stop;    /* set from outside */
    int32_t failed_index, failed_status;
    int32_t failed_signal;
} engine_t;

#endif
