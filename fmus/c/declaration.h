/* declaration.h - the interface between a model and the FMI layer: functions and tables.
 *
 * The layer is the same for every model. `variables.c`, generated from a model's declaration,
 * defines the tables below; their sizes stand in `declared`.
 */
#ifndef DECLARATION_H
#define DECLARATION_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>

#include "real.h"

/* A model's variables: numbers in the order of the declaration, without padding. The members stand
 * in `variables.h`, also generated. */
typedef struct Model Model;

/* Calculate what follows from start values, parameters and inputs; may be called repeatedly.
 * NULL, or a message that says why the values are not possible. */
const char *model_initial(Model *x);

/* Advance from time t by one step h > 0, in s. NULL, or a message that says why this failed; then no
 * value has changed. */
const char *model_step(Model *x, double t, double h);

/* Steps from t[0], ... t[m - 1] of n instances, with the same bits, as many as model_lanes() <= WIDEST at once, each up to
 * the first that fails: it has made[k] of them, and why[k] is what model_step returned last. */
enum { WIDEST = 8 };
typedef void Steps(Model *const x[], size_t n, const double t[], size_t m, double h, size_t made[],
                   const char *why[]);
typedef size_t Lanes(void);
Steps model_steps;
Lanes model_lanes;

/* Of a model for model exchange: calculate derivatives of the states and outputs from states, parameters
 * and inputs. NULL, or a message that says why this failed. */
typedef const char *Rates(Model *x);
Rates model_rates;

/* The FMI type of a variable and what may be done with it; bits of `Variable.access`. */
enum {
    IS_REAL = 1,
    IS_INTEGER = 2,
    IS_BOOLEAN = 4,
    SET_AT_START = 8,   /* before and in Initialization Mode: parameters, inputs, start values */
    SET_IN_STEPS = 16,  /* between steps: inputs */
    IS_CALCULATED = 32, /* by model_initial */
    IS_PARAMETER = 64,
    IS_SIZE = 128 /* the structural parameter; set in Configuration Mode */
};

typedef struct {
    const char *name;
    unsigned char access;
    unsigned offset, size; /* scalars, in Model */
    unsigned each;         /* scalars for each unit of the structural parameter, 0: `size` whatever it is */
    double minimum, maximum;
} Variable;

typedef struct {
    unsigned first, size; /* scalars, in Model */
} Range;

typedef struct {
    const char *identifier, *token;
    uint64_t layout; /* differs where variables or their order do */
    unsigned n_variables, n_scalars, n_input_ranges;
    unsigned structural; /* place of the structural parameter in Model; n_scalars: there is none */
    int is_clocked;
    double clock_interval; /* s, of a model with a clock */
    Steps *steps;          /* model_steps of a model whose step is written for several, else NULL */
    Lanes *lanes;          /* model_lanes of such a model */
    Rates *rates;          /* model_rates of a model for model exchange, else NULL */
    unsigned n_states;     /* scalars */
} Declaration;

extern const Declaration declared;

/* The entry after the last variable is the time. */
extern const Variable variables[];          /* n_variables + 1 */
extern const unsigned char scalar_access[]; /* n_scalars + 1 */
extern const char *const scalar_names[];    /* n_scalars + 1 */
extern const double start_values[];         /* n_scalars */
extern const unsigned state_places[];       /* n_states: of the states in Model, */
extern const unsigned rate_places[];        /* and of their derivatives */
extern const Range input_ranges[];          /* n_input_ranges, in the order of `first` */

/* Whether n values are numbers and finite. */
static inline int all_finite(const Real *values, unsigned n)
{
#if TOGETHER == 1
    uint64_t carry = 0; /* an exponent of all ones, not a finite number's, and one more is the sign bit */
    for (unsigned i = 0; i < n; i++) {
        const union {
            double number;
            uint64_t bits;
        } value = {values[i]};
        carry |= (value.bits & 0x7ff0000000000000u) + 0x0010000000000000u;
    }
    return !(carry >> 63);
#else
    Truth finite = ALWAYS;
    for (unsigned i = 0; i < n; i++) finite &= values[i] - values[i] == 0.0;
    return ALL(finite);
#endif
}

/* Write n torques if all are finite; otherwise return a message. */
static inline const char *give_torques(const Real *tau, Real *given, unsigned n)
{
    if (!all_finite(tau, n)) return "the torque left the range of numbers";
    for (unsigned i = 0; i < n; i++) given[i] = tau[i];
    return 0;
}

#endif
