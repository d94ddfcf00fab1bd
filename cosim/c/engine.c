/* engine.c: executes a plan.
 *
 * A plan is a flat array of operations over one contiguous vector of doubles (the signals), in
 * segments that are due every `period` ticks; time is (tick * h), never a sum. The loop handles FMI
 * function pointers, ticks and signals only. It contains no code for Python, robots or networks,
 * and neither allocates nor prints. It is called with the GIL released, in chunks of ticks.
 *
 * Its units are compiled as one; each calls only those above it in this list.
 */
#define ENGINE_WHOLE

#include "engine/fmu_log.c"
#include "engine/numbers.c"
#include "engine/typed_values.c"
#include "engine/clocks.c"
#include "engine/events.c"
#include "engine/scheduled.c"
#include "engine/typed_steps.c"
#include "engine/exchange_calls.c"
#include "engine/cvode.c"
#include "engine/solvers.c"
#include "engine/model_exchange.c"
#include "engine/fmi_steps.c"
#include "engine/steps_at_once.c"
#include "engine/rollback.c"
#include "engine/direct_outputs.c"
#include "engine/macro_steps.c"
#include "engine/plain_steps.c"
#include "engine/operations.c"
#include "engine/partitions.c"
#include "engine/run.c"
#include "engine/batch.c"
