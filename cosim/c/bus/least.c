/* least.c: the least of the numbers of all nodes, for buses with many nodes. */
#include "internal.h"

int32_t least_leaves(int32_t nodes)
{
    int32_t leaves = 1;
    while (leaves < nodes) leaves *= 2;
    return leaves;
}

void least_set(least_t *l, int32_t node, int64_t number)
{
    int64_t *rows = l->rows;
    int32_t k = l->leaves + node;
    if (rows[k] == number) return;
    rows[k] = number;
    while (k > 1) {
        int64_t other = rows[k ^ 1], least = rows[k] < other ? rows[k] : other;
        k /= 2;
        if (rows[k] == least) return;
        rows[k] = least;
    }
}

int64_t least_of(const least_t *l) { return l->rows[1]; }

int32_t least_node(const least_t *l)
{
    int32_t k = 1;
    while (k < l->leaves) k = 2 * k + (l->rows[2 * k] != l->rows[1]);
    return k - l->leaves;
}

int64_t least_other(const least_t *l, int32_t node, int32_t *before)
{
    int64_t least = NEVER;
    *before = 0;
    for (int32_t k = l->leaves + node; k > 1; k /= 2) {
        int64_t other = l->rows[k ^ 1];
        if (other < least) {
            least = other;
            *before = k & 1;
        } else if (other == least) {
            *before |= k & 1;
        }
    }
    return least;
}
