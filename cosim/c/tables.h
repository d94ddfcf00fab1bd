/* tables.h: the rows of tables of links, drawn for many of them at once. cosim/native/tables.py repeats
 * it for Python. */
#ifndef COSIM_TABLES_H
#define COSIM_TABLES_H

#include <stdint.h>

#include "engine.h"

enum { RULE_SIGNAL, RULE_LAST_ARRIVAL, RULE_NEWEST_STAMP, RULE_FIFO, RULE_PLAYOUT };

/* The generator PCG64 of NumPy: PCG XSL RR 128/64; numbers of 128 bits, the higher word first. */
typedef struct {
    uint64_t state[2], increment[2];
} pcg_t;

/* A sample on its way. */
typedef struct {
    int64_t arrival;        /* ticks */
    int64_t sample;
} packet_t;

/* A table, and how far it is drawn. Where `delays` are given the law is not asked. */
typedef struct {
    double low, width, high;    /* s: a draw is min(low + width u, high), u ~ U[0, 1) */
    int64_t draws, samples;     /* so many draws in so many samples; 0 in 1: one for all */
    double lost;                /* the probability that a packet is lost */
    double h;                   /* s, base step */
    int64_t n_s, n_r;           /* ticks, periods of sender and receiver */
    int64_t buffer;             /* ticks, of RULE_PLAYOUT */
    int32_t rule, reserved;
    pcg_t delay, loss;          /* the generators of delays and losses */
    double drawn, played;       /* s: the last draw; the delay of the sample that is played */
    int64_t rest;               /* rest/samples draws, rounded down, are made for the next sample */
    int64_t row, sent, held;    /* the next row, the next sample; what is held */
    int64_t arrived;            /* tick at which the last packet arrives, of RULE_FIFO */
    packet_t *pending;          /* capacity */
    int64_t n_pending, capacity;
    const double *delays;       /* s, of the next samples; NULL: they are drawn */
    int32_t *rows;              /* n: what is asked for */
    int64_t n;
} table_t;

/* Seed the generators as numpy.random.SeedSequence does: the entropy of table i are the words from
 * ends[i - 1] (or 0) up to ends[i]; losses have that of its first child. */
API void tables_seed(table_t *tables, int64_t n_tables, const uint32_t *words, const int64_t *ends);

/* Fill in the next rows of all tables; returns the first one with a delay that its law rules out, or
 * -1. */
API int64_t tables_rows(table_t *tables, int64_t n_tables);

#endif
