/* start.h: what the start of components is in memory. */
#ifndef COSIM_START_H
#define COSIM_START_H

#include "engine.h"

/* Stages of the start: into Initialization Mode; outputs for inputs, as often as they change; out of it. */
enum stage { STAGE_ENTER, STAGE_SAY, STAGE_LEAVE };

/* What a call of an FMU is; its first argument is the instance. */
enum form {
    FORM_OTHER,   /* one that Python does */
    FORM_NOTHING, /* there is nothing to do */
    FORM_MODE,    /* no more arguments */
    FORM_SETUP2,  /* fmi2SetupExperiment */
    FORM_ENTER3,  /* fmi3EnterInitializationMode */
    FORM_VALUES2, /* value references, their number, values */
    FORM_VALUES3
}; /* the same, and the number of values */

/* Where the values of a call are. */
enum value_place {
    VALUES_ROW,     /* in the row of the component */
    VALUES_SIGNALS, /* among the signals, `place` bytes behind its first input or output */
    VALUES_EQUAL
}; /* they are got, and expected to equal those in the row */

enum number { NUMBER_WHOLE, NUMBER_FLOAT, NUMBER_DOUBLE };

/* Why Python has to do something. */
enum start_result { START_DONE, START_OTHER, START_REFUSED, START_DIFFERENT, START_CHANGED, START_RESTLESS };

typedef struct {
    void *function;
    const uint32_t *references;
    int64_t n_references, n_values;
    int64_t place, bytes; /* of the values */
    double tolerance;
    int32_t form, values, number, output; /* output: VALUES_SIGNALS are outputs */
    int32_t has_tolerance, reserved;
} start_call_t;

/* The calls that components of a kind have in common; those of stage s are from first[s] on. */
typedef struct {
    const start_call_t *calls;
    int64_t first[STAGE_LEAVE + 2];
} start_kind_t;

typedef struct {
    const start_kind_t *kind;
    void *instance;
    const char *row;                            /* its values, as its FMU takes them */
    int64_t input, n_inputs, output, n_outputs; /* among the signals */
} starting_t;

/* A wire or a link before its first sample; `initial`: what it brings whatever its source is. */
typedef struct {
    const double *initial;
    int64_t source, target, count;
    double gain, offset;
} bringing_t;

typedef struct {
    const starting_t *components;
    const int64_t *order;       /* in which components leave */
    const bringing_t *bringing; /* by what they feed: those of component i are from fed[i] on */
    const int64_t *fed;
    const int64_t *feeds, *first_fed; /* the components that i feeds are feeds[first_fed[i]] ... */
    double *signals, *known, *before; /* known: inputs for which outputs were asked; before: old outputs */
    uint8_t *stale, *waiting;         /* components to be asked in the next pass, and in this one */
    uint8_t *asked, *unsettled;       /* has `known` inputs; its outputs may still be computed */
    char *room;                       /* for the values of any call */
    double begin;                     /* s */
    int64_t n, at, call; /* components, or how many leave; the place of the one at hand, its next call */
    int64_t passes;
    int32_t status, changed, saying, leaving;
} start_t;

#endif
