/* tables.h: the rows of tables of links, drawn for many of them at once. */
#ifndef COSIM_TABLES_H
#define COSIM_TABLES_H

#include <stdint.h>

#include "engine.h"

enum rule_code { RULE_SIGNAL, RULE_LAST_ARRIVAL, RULE_NEWEST_STAMP, RULE_FIFO, RULE_PLAYOUT, RULE_QUEUE };

/* Options of RULE_QUEUE: a full queue drops the sample that arrives, not its first; a look takes all. */
enum queue_bit { QUEUE_DROP_NEWEST = 1 << 0, QUEUE_TAKE_ALL = 1 << 1 };

/* The generator PCG64 of NumPy: PCG XSL RR 128/64; numbers of 128 bits, the higher word first. */
typedef struct {
    uint64_t state[2], increment[2];
} pcg_t;

/* A sample on its way. */
typedef struct {
    int64_t arrival; /* ticks */
    int64_t sample;
} packet_t;

/* A table, and how far it is drawn. If `delays` is not NULL, they are taken and none are drawn. */
typedef struct {
    double low, width, high; /* s: a draw is min(low + width u, high), u ~ U[0, 1) */
    int64_t draws, samples;  /* so many draws in so many samples; 0 in 1: one for all */
    double lost;             /* the probability that a packet is lost */
    double h;                /* s, base step */
    int64_t n_s, n_r;        /* ticks, periods of sender and receiver */
    int64_t buffer;          /* ticks, of RULE_PLAYOUT */
    int32_t rule, queue;     /* `queue`: enum queue_bit */
    int64_t depth;           /* of the queue */
    pcg_t delay, loss;       /* the generators of delays and losses */
    double drawn, played;    /* s: the last draw; the delay of the sample that is played */
    int64_t rest;            /* rest/samples draws, rounded down, are made for the next sample */
    int64_t row, sent, held; /* the next row, the next sample; what is held */
    int64_t arrived;         /* tick at which the last packet arrives, of RULE_FIFO */
    packet_t *pending;       /* capacity; of RULE_QUEUE by arrival, those that wait in the queue first */
    int64_t n_pending, capacity, waiting;
    const double *delays; /* s, of the next samples; NULL: they are drawn */
    int32_t *rows;        /* n: what is asked for */
    int64_t n;
} table_t;

/* Seed the generators as numpy.random.SeedSequence does: the entropy of table i are the words from
 * ends[i - 1] (or 0) up to ends[i]; losses have that of its first child. */
API void tables_seed(table_t *tables, int64_t n_tables, const uint32_t *words, const int64_t *ends);

/* Fill in the next rows of all tables; returns the first one with a delay that its law rules out, or
 * -1. */
API int64_t tables_rows(table_t *tables, int64_t n_tables);

/* The samples that the rows of a table hold, counted; periods and ages are in parts of the greatest
 * time that both periods are multiples of. */
typedef struct {
    int64_t n_s, n_r;
    int64_t row;               /* the next row */
    int64_t held, backwards;   /* rows that hold the same as the row before, or an older sample */
    int64_t waiting, used;     /* rows that hold nothing; samples that a row held */
    int64_t newest, before;    /* samples: the newest held, the last held; -1: none */
    int64_t *counts, n_counts; /* rows by age; the ages of rows to come are below n_counts */
    int32_t *seen;             /* by the last bits of a sample: the last one that was held, or -1 */
    int64_t last;              /* the mask of these bits */
    const int32_t *rows;       /* n: to be counted */
    int64_t n;
} ages_t;

/* Raise n_counts as far as the rows need. */
API void ages_reach(ages_t *tables, int64_t n_tables);

/* Count the rows. */
API void ages_count(ages_t *tables, int64_t n_tables);

/* For each table and each of its `ranks` (n_tables, n_ranks), ascending within a table: the least age that at least
 * so many of its rows do not exceed, to `ages` (n_tables, n_ranks); -1 for rank 0. No rank is greater than the
 * number of rows that hold a sample. */
API void ages_ranks(const ages_t *tables, int64_t n_tables, const int64_t *ranks, int64_t n_ranks,
                    int64_t *ages);

#endif
