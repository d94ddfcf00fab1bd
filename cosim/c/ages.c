/* ages.c: the ages of the samples that rows of links' tables hold, counted for many tables at once;
 * cosim/links/table.py says what the numbers are. */
#include "tables.h"

void ages_reach(ages_t *tables, int64_t n_tables)
{
    for (ages_t *t = tables; t < tables + n_tables; t++) {
        for (int64_t i = 0; i < t->n; i++) {
            const int64_t age = t->n_r * (t->row + i) - t->n_s * t->rows[i];
            if (t->rows[i] >= 0 && age >= t->n_counts) t->n_counts = age + 1;
        }
    }
}

void ages_count(ages_t *tables, int64_t n_tables)
{
    for (ages_t *t = tables; t < tables + n_tables; t++) {
        for (int64_t i = 0; i < t->n; i++, t->row++) {
            const int32_t sample = t->rows[i];
            if (sample < 0) {
                t->waiting++;
                continue;
            }
            t->counts[t->n_r * t->row - t->n_s * sample]++;
            if (sample == t->before) {
                t->held++;
                continue;
            }
            t->backwards += sample < t->before;
            t->before = sample;
            if (sample > t->newest) t->newest = sample;
            if (t->seen[sample & t->last] != sample) {
                t->seen[sample & t->last] = sample;
                t->used++;
            }
        }
    }
}

void ages_ranks(const ages_t *tables, int64_t n_tables, const int64_t *ranks, int64_t n_ranks, int64_t *ages)
{
    for (int64_t i = 0; i < n_tables; i++) {
        int64_t reached = 0, age = -1;
        for (int64_t k = i * n_ranks; k < (i + 1) * n_ranks; k++) {
            while (reached < ranks[k]) reached += tables[i].counts[++age];
            ages[k] = age;
        }
    }
}
