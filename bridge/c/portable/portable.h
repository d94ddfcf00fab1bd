/* portable.h - a node of a deployment in one piece of memory, without an operating system.
 *
 * A slot of the node is node_slot (slot.h), as in the twin. Here are the plan of its
 * components, whose C kernels are beside it, and its start. It is the core of an FMU (lsbus/core.h) and of
 * firmware (firmware/firmware.h), each of which has its own attachment to buses and clocks.
 * node_data.h and node_data.c are generated from the scenario and its deployment; memory_t begins with
 *
 *   node_t node;                       the node, and what it points to: inlets, outlets, guards ...
 *   gate_t gates[];                    functions of inlets and outlets, called by the plan
 *   double signals[], seen[];          seen: as they were recorded in the last slot, for the outputs
 *   double kernels[];                  the variables of all components
 */
#ifndef PORTABLE_H
#define PORTABLE_H

#include "node.h"

/* The functions of a model's kernel (kernel.c). */
typedef struct {
    size_t (*size)(void);
    void (*reset)(double *x);
    const char *(*initial)(double *x);
    const char *(*step)(double *x, double t, double h);
} kernel_t;

/* `count` values from one place to another. */
typedef struct {
    int32_t from, to, count;
} move_t;

/* A component: its variables begin at `first` of memory_t.kernels. Moves: of `values` to its variables,
 * of signals to its variables, of its variables to signals. `lag`: ticks from the beginning of a step to
 * the tick in which it is done; h: s. */
typedef struct {
    const char *name;
    const kernel_t *kernel;
    const double *values;
    const move_t *given, *inputs, *outputs;
    int32_t n_given, n_inputs, n_outputs, first, size, lag;
    double h;
} unit_t;

/* An operation of the plan, like operation_t of the engine; `first`: its first tick. */
enum { PLAN_COPY, PLAN_STEP, PLAN_GATE, PLAN_PLAY, PLAN_RECORD };
typedef struct {
    int32_t code, index;
    int64_t period, first;
    int32_t source, target, count;
    double gain, offset;
} plan_operation_t;

/* Values of an input over time, one each time it is due; after the last one it keeps that. */
typedef struct {
    const double *values;
    int64_t count;
} played_values_t;

typedef struct {
    int32_t (*passing)(void *context, int64_t tick, double *signals);
    void *context;
} gate_t;

/* Bit rates of a bus, bit/s; data: 0 of a classic one. */
typedef struct {
    uint32_t nominal, data;
} rates_t;

#include "node_data.h" /* N_..., H, TOKEN, memory_t */

extern const memory_t node_first;              /* the node at its start */
extern const size_t node_pointers[N_POINTERS]; /* where it points into itself */
extern const rates_t node_rates[N_BUSES];
extern const unit_t node_units[N_UNITS];
extern const plan_operation_t node_operations[N_OPERATIONS];
extern const played_values_t node_players[N_PLAYERS];
extern const move_t node_outputs[N_OUTPUTS]; /* `from`: of signals */

typedef struct {
    memory_t memory;
    const char *who, *why; /* the component that stopped, and its reason; NULL: none has stopped */
    bus_t buses[N_BUSES];
    journal_t none; /* without rows */
    double *record;
    int64_t record_row;
    frame_t pending[N_BUSES];
    int32_t has_pending[N_BUSES];
} portable_t;

/* The node as it starts, attached to `buses`, which have a number and nothing else. */
void portable_reset(portable_t *x);
/* All components at their start. NULL, or why not. */
const char *plan_begin(portable_t *x);
/* The plan of the node's components, one tick: the function `run` of node_t, whose engine is `context`. */
int32_t plan_run(void *context, int64_t ticks);

#endif
