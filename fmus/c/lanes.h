/* lanes.h - the end of lanes_4.c and lanes_8.c: steps of TOGETHER instances.
 *
 * All values are copied to a Model of lanes, and those that a step may change back to the instances.
 */

/* Like Real, but it may lie at the address of any double. */
typedef double Row __attribute__((vector_size(8 * TOGETHER), aligned(8), may_alias));

#ifdef __clang__
#define CHOSEN(a, b, ...) __builtin_shufflevector(a, b, __VA_ARGS__)
#else
#define CHOSEN(a, b, ...) __builtin_shuffle(a, b, (Truth){__VA_ARGS__})
#endif

/* Of the rows a and b: blocks of `size` entries, alternately of a and of b. LOW_ takes the first block of each
 * pair of blocks, HIGH_ the second. */
#if TOGETHER == 4
#define LOW_1(a, b) CHOSEN(a, b, 0, 4, 2, 6)
#define HIGH_1(a, b) CHOSEN(a, b, 1, 5, 3, 7)
#define LOW_2(a, b) CHOSEN(a, b, 0, 1, 4, 5)
#define HIGH_2(a, b) CHOSEN(a, b, 2, 3, 6, 7)
#else
#define LOW_1(a, b) CHOSEN(a, b, 0, 8, 2, 10, 4, 12, 6, 14)
#define HIGH_1(a, b) CHOSEN(a, b, 1, 9, 3, 11, 5, 13, 7, 15)
#define LOW_2(a, b) CHOSEN(a, b, 0, 1, 8, 9, 4, 5, 12, 13)
#define HIGH_2(a, b) CHOSEN(a, b, 2, 3, 10, 11, 6, 7, 14, 15)
#define LOW_4(a, b) CHOSEN(a, b, 0, 1, 2, 3, 8, 9, 10, 11)
#define HIGH_4(a, b) CHOSEN(a, b, 4, 5, 6, 7, 12, 13, 14, 15)
#endif
#define EXCHANGE_BLOCKS(rows, size)                            \
    UNROLLED for (int k = 0; k < TOGETHER; k++)                \
    {                                                          \
        if (k & size) continue;                                \
        const Real low = LOW_##size(rows[k], rows[k + size]);  \
        rows[k + size] = HIGH_##size(rows[k], rows[k + size]); \
        rows[k] = low;                                         \
    }

/* Rows to columns of a square. */
static inline void transpose(Real rows[TOGETHER])
{
    EXCHANGE_BLOCKS(rows, 1)
    EXCHANGE_BLOCKS(rows, 2)
#if TOGETHER == 8
    EXCHANGE_BLOCKS(rows, 4)
#endif
}

/* Each scalar of the instances `x` as a vector. */
static inline void gather(double *const x[], Real all[])
{
    int i = 0;
    for (; i + TOGETHER <= N_SCALARS; i += TOGETHER) {
        Real rows[TOGETHER];
        UNROLLED for (int k = 0; k < TOGETHER; k++) rows[k] = *(const Row *)(x[k] + i);
        transpose(rows);
        UNROLLED for (int k = 0; k < TOGETHER; k++) all[i + k] = rows[k];
    }
    for (; i < N_SCALARS; i++) UNROLLED for (int k = 0; k < TOGETHER; k++) all[i][k] = x[k][i];
}

static inline void scatter(const Real all[], Range changed, double *const x[])
{
    unsigned i = changed.first;
    const unsigned end = changed.first + changed.size;
    for (; i + TOGETHER <= end; i += TOGETHER) {
        Real rows[TOGETHER];
        UNROLLED for (int k = 0; k < TOGETHER; k++) rows[k] = all[i + (unsigned)k];
        transpose(rows);
        UNROLLED for (int k = 0; k < TOGETHER; k++) * (Row *)(x[k] + i) = rows[k];
    }
    for (; i < end; i++) UNROLLED for (int k = 0; k < TOGETHER; k++) x[k][i] = all[i][k];
}

static inline int have_in_common(const Real all[], Range integers)
{
    Truth differ = {0};
    for (unsigned i = integers.first; i < integers.first + integers.size; i++)
        differ |= all[i] != COMMON(all[i]);
    return !ANY(differ);
}

size_t WIDE_STEPS(double *const x[], const double t[], size_t m, double h)
{
    static const Range integers[] = MODEL_INTEGERS, changed[] = MODEL_CHANGED;
    union {
        Model model;
        Real scalars[N_SCALARS];
    } all;
    size_t made = 0;
    gather(x, all.scalars);
    for (unsigned i = 0; i < sizeof integers / sizeof integers[0]; i++)
        if (!have_in_common(all.scalars, integers[i])) return 0;
    while (made < m && model_step(&all.model, t[made], h) == NULL) made++;
    for (unsigned i = 0; made && i < sizeof changed / sizeof changed[0]; i++)
        scatter(all.scalars, changed[i], x);
    return made;
}
