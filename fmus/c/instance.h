/* instance.h - one instance of a model: the parts that FMI 2.0 and FMI 3.0 share.
 *
 * These are modes, logging, values, saved states and steps, independent of the version of the API. The
 * entry points in fmi2.c and fmi3.c check what is specific to their version, and call the functions
 * here with their own name, which messages contain.
 *
 * A call that is refused (STATUS_ERROR) or discarded changes nothing.
 */
#ifndef INSTANCE_H
#define INSTANCE_H

#include <stddef.h>
#include <stdint.h>

#include "declaration.h"

/* The same numbers in fmi2Status and fmi3Status. */
typedef enum { STATUS_OK, STATUS_WARNING, STATUS_DISCARD, STATUS_ERROR } Status;

/* The mode is one bit; what a function allows is several. */
enum {
    INSTANTIATED = 1,
    INITIALIZATION = 2,
    STEPPING = 4,    /* 2.0: stepComplete, 3.0: Step Mode */
    STEP_FAILED = 8, /* 2.0 only: fmi2DoStep returned fmi2Discard */
    TERMINATED = 16,
    EVENT = 32,         /* Event Mode: of a model with a clock (3.0), or for model exchange */
    CONFIGURATION = 64, /* 3.0, of a model with a structural parameter */
    CONTINUOUS = 128    /* of a model for model exchange: Continuous-Time Mode */
};

/* Log categories, bits. */
enum { LOG_EVENTS = 1, LOG_WARNING = 2, LOG_DISCARD = 4, LOG_ERROR = 8, LOG_ALL = 15 };

#define TIME (declared.n_scalars)                  /* index of the time in Instance.values */
#define N_STORED (declared.n_scalars + 1)          /* values and the time */
#define CLOCK_REFERENCE (declared.n_variables + 1) /* FMI 3.0 value reference, after the time */

/* The clock of a model that has one, see clock.c. */
typedef struct {
    unsigned used;   /* 1: the importer activates the clock in Event Mode; 0: steps do */
    unsigned active; /* between its tick and the update of the discrete states */
    double count;    /* ticks until now */
    double *before;  /* N_STORED values before the tick that is active; NULL without a clock */
} Clock;

typedef struct Instance Instance;
typedef void AnyFunction(void);
typedef void Forward(const Instance *x, Status status, const char *category, const char *text);

struct Instance {
    unsigned mode;
    int stale;                    /* calculated variables are out of date */
    unsigned categories;          /* that are logged */
    double start_time, stop_time; /* s; stop_time is infinite where none is defined */
    Forward *forward;             /* knows the type of `callback` */
    AnyFunction *callback;
    void *environment;
    char *name;
    Clock clock;
    double values[]; /* the model's, and the time (s); N_STORED */
};

typedef struct Snapshot Snapshot;

/* The scalars that a variable has in this instance. */
static inline unsigned size_of(const Instance *x, const Variable *v)
{
    return v->each ? v->each * (unsigned)x->values[declared.structural] : v->size;
}

/* --- instance.c --------------------------------------------------------------------------- */

/* NULL, after logging a message, if name or token do not match or there is no memory. */
Instance *instance_new(const char *name, const char *token, int logging, Forward *forward,
                       AnyFunction *callback, void *environment, const char *function);
void instance_free(Instance *x);

/* Log the message "function: ..." and return STATUS_ERROR. `x` may be NULL: nothing is logged. */
Status refuse(const Instance *x, const char *function, const char *format, ...);
/* The same for STATUS_DISCARD. */
Status discard(const Instance *x, const char *function, const char *format, ...);
/* Describe why a variable with this `access` does not allow `need`; `type` is the name of its type. */
Status refuse_access(const Instance *x, const char *function, const char *name, const char *type,
                     unsigned access, unsigned need);
int refuse_mode(const Instance *x, unsigned allowed, const char *function);

/* Whether `function` may be called now; if not, that is logged. */
static inline int legal(const Instance *x, unsigned allowed, const char *function)
{
    return x != NULL && (x->mode & allowed) ? 1 : refuse_mode(x, allowed, function);
}

Status set_logging(Instance *x, int on, size_t n, const char *const categories[], const char *function);
Status set_up(Instance *x, double start, int stop_defined, double stop, const char *function);
Status enter_initialization(Instance *x);
Status exit_initialization(Instance *x, const char *function);
Status terminate(Instance *x);
Status reset(Instance *x);

/* Recalculate what depends on start values, parameters and inputs, before the first step. */
Status settle(Instance *x, const char *function);

/* The first input that is not finite, or the time. */
static inline unsigned find_not_finite(const double *values)
{
    for (unsigned i = 0; i < declared.n_input_ranges; i++) {
        const Range range = input_ranges[i];
        if (all_finite(values + range.first, range.size)) continue;
        for (unsigned k = range.first; k < range.first + range.size; k++)
            if (!all_finite(values + k, 1)) return k;
    }
    return TIME;
}

/* STATUS_DISCARD, after logging a message, if an input is not finite at time t, in s. */
Status check_inputs(const Instance *x, double t, const char *function);

/* --- exchange.c: models for model exchange -------------------------------------------------- */

/* Whether `function` may be called in this mode of a model for model exchange, with n numbers. */
int exchangeable(const Instance *x, unsigned modes, const void *numbers, size_t n, size_t expected,
                 const char *function);
Status exchange_set_time(Instance *x, double t, const char *function);
Status exchange_set_states(Instance *x, const double *states, size_t n, const char *function);
Status exchange_get_states(Instance *x, double *states, size_t n, const char *function);
Status exchange_get_rates(Instance *x, double *rates, size_t n, const char *function);
Status exchange_get_nominals(Instance *x, double *nominals, size_t n, const char *function);
/* Some scalars, by their places in `values`. */
typedef struct {
    const unsigned *places;
    size_t n;
} Places;
/* Derivatives of `unknowns` along `seed`, a direction of `knowns`, by differences of order four. */
Status exchange_directional(Instance *x, Places unknowns, Places knowns, const double *seed,
                            double *sensitivity, const char *function);

/* --- clock.c: models with a clock ---------------------------------------------------------- */

/* Activate the clock; or log a message and leave everything as it was. */
Status clock_activate(Instance *x, const char *function);
/* Compute the values of the active tick from the inputs; may be called repeatedly. */
Status clock_evaluate(Instance *x, const char *function);
/* End the active tick: its values become permanent. */
Status clock_update(Instance *x, const char *function);
/* A communication step h (s) from t (s): its ticks, or whether the importer has given them. */
Status step_clocked(Instance *x, double t, double h, const char *function);

/* --- stepping.c ----------------------------------------------------------------------------- */

/* One communication step h (s) from t (s). */
Status do_step(Instance *x, double t, double h, const char *function);
/* Steps of n instances from t[0], ... t[m - 1]. An instance stops at its first step that fails: made[k] is how many steps
 * instance k has made before it, and status[k] its Status, which is an error for one that may not be stepped now. */
void do_steps(Instance *const x[], size_t n, const double t[], size_t m, double h, const char *function,
              int status[], size_t made[]);

/* --- state.c ------------------------------------------------------------------------------ */

/* `*state` is reused; if it is NULL, memory is allocated. */
Status state_save(const Instance *x, void **state, const char *function);
Status state_restore(Instance *x, const Snapshot *state, const char *function);
Status state_free(const Instance *x, void **state, const char *function);
Status state_size(const Instance *x, const Snapshot *state, size_t *size, const char *function);
Status state_write(const Instance *x, const Snapshot *state, unsigned char bytes[], size_t size,
                   const char *function);
Status state_read(const Instance *x, const unsigned char bytes[], size_t size, void **state,
                  const char *function);

#endif
