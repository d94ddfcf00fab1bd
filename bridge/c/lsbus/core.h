/* core.h - a node of a deployment as the core of an FMU with a CAN terminal for each of its buses (lsbus.h).
 *
 * What a slot of the node does is node_slot (slot.h), as in the twin. Here are the plan of its
 * components, whose C kernels are in the FMU, and its attachment to the terminals in place of bus.c.
 * node_data.h and node_data.c are generated from the scenario and its deployment; memory_t begins with
 *
 *   node_t node;                       the node, and what it points to: inlets, outlets, guards ...
 *   gate_t gates[];                    functions of inlets and outlets, called by the plan
 *   double signals[], seen[];          seen: as they were recorded in the last slot, for the outputs
 *   double kernels[];                  the variables of all components
 */
#ifndef CORE_H
#define CORE_H

#include "lsbus.h"
#include "node.h"

enum { WAITING = 256 }; /* frames between two slots, a power of two */

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

/* As operation_t of the engine; `first`: its first tick. */
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

enum { N_PORTS = N_BUSES };

extern const memory_t node_first;              /* the node at its start */
extern const size_t node_pointers[N_POINTERS]; /* where it points into itself */
extern const rates_t node_rates[N_BUSES];
extern const unit_t node_units[N_UNITS];
extern const plan_operation_t node_operations[N_OPERATIONS];
extern const played_values_t node_players[N_PLAYERS];
extern const move_t node_outputs[N_OUTPUTS]; /* `from`: of signals */

struct fmu {
    LSBUS_MEMBERS(N_BUSES);
    memory_t memory;
    const char *who, *why; /* the component that stopped, and its reason; NULL: none has stopped */
    bus_t buses[N_BUSES];
    ring_t received[N_BUSES], sent[N_BUSES];
    frame_t received_frames[N_BUSES][WAITING], sent_frames[N_BUSES][WAITING];
    journal_t none; /* without rows */
    double *record;
    int64_t record_row;
    frame_t pending[N_BUSES];
    int32_t has_pending[N_BUSES];
};

/* The plan of the node's components, one tick: the function `run` of node_t. */
int32_t plan_run(void *context, int64_t ticks);
/* All components at their start. NULL, or why not. */
const char *plan_begin(fmu_t *x);
/* An operation that has arrived from a bus at `at_ns`. */
fmi3Status operation_take(fmu_t *x, int32_t bus, const uint8_t *raw, size_t n, int64_t at_ns);
/* Put the bit rates of a bus, or a frame, into its `tx`. */
fmi3Status operation_rates(fmu_t *x, int32_t bus);
fmi3Status operation_send(fmu_t *x, int32_t bus, const frame_t *frame);

#endif
