/* plan.c - runs a plan with every operation that has numbers in it, tick by tick and in parts, and
 * prints a digest of all signals at all ticks.
 */
#include "engine.c"

#include <stdlib.h>

#include "digest.h"

enum { TICKS = 3000, LEAST = 9, CAPACITY = 64, A_IN = 0, A_OUT = 4, B_IN = 6, B_OUT = 12, LAST = 14, N = 24 };

/* Two numbers that swing, pushed by the inputs and kept finite by a division. */
static int32_t swing(void *instance, double t, double h, const double *u, double *y)
{
    double *x = instance, force = 0.125 * t / (1.0 + t);
    for (int i = 0; i < 4; i++) force += (0.5 - 0.25 * i) * u[i];
    x[1] += h * (force - 3.0 * x[0] - 0.1 * x[1] * x[1] * x[1]);
    x[0] += h * x[1];
    x[1] /= 1.0 + 1e-3 * x[1] * x[1];
    y[0] = x[0], y[1] = x[1];
    return 0;
}

typedef struct {
    double x[2][2], signals[N], rows[TICKS * N], history[2][CAPACITY], initial[2], played[TICKS];
    int32_t table[2][TICKS];
    operation_t operations[32];
    segment_t segments[32], own[2][16];
    unit_t units[2];
    sender_t senders[2];
    link_t links[2];
    player_t players[1];
    stretch_t stretches[3];
    columns_t columns[3];
    part_t parts[2];
    member_t members[1];
    int64_t places[32];
    team_t team;
    engine_t engine;
} world_t;

/* The operations of a tick: by whose part they are, 'a', 'b' or both. */
static const struct {
    char of;
    operation_t op;
} plan[] = {
    {'a', {OP_PUSH, 0, 1, A_OUT, 0, 1, 1.5, 0.25}},
    {'b', {OP_PUSH, 1, 1, B_OUT, 0, 1, 1.0, 0.0}},
    {'x', {OP_RECORD, 0, 1, 0, 0, 1, 1.0, 0.0}},
    {'a', {OP_PULL, 1, 1, 0, A_IN, 1, 1.0, 0.0}},
    {'a', {OP_AGE, 1, 1, 1, A_IN + 1, 1, 1.0, 0.0}},
    {'a', {OP_SCALE, 0, 1, A_OUT, A_IN + 2, 1, -0.7, 0.1}},
    {'a', {OP_AHEAD, LAST, 1, A_OUT + 1, A_IN + 3, 1, 0.3, 0.0}},
    {'b', {OP_PULL, 0, 1, 0, B_IN, 1, 1.0, 0.0}},
    {'b', {OP_COPY, 0, 1, B_OUT, B_IN + 1, 1, 1.0, 0.0}},
    {'b', {OP_BETWEEN, LAST + 1, 1, B_OUT + 1, B_IN + 2, 1, 1.1, -0.1}},
    {'b', {OP_SLOPE_BETWEEN, LAST + 2, 1, B_OUT, B_IN + 4, 1, 0.9, 0.0}},
    {'b', {OP_PLAY, 0, 1, 0, B_IN + 3, 1, 1.0, 0.0}},
    {'a', {OP_STEP, 0, 1, 0, 0, 0, 1.0, 0.0}},
    {'b', {OP_STEP, 1, 1, 0, 0, 0, 1.0, 0.0}},
};
enum { OPERATIONS = sizeof plan / sizeof plan[0] };

static void set_part(world_t *w, int k, int64_t *next)
{
    part_t *part = w->parts + k;
    part->segments = w->own[k];
    w->own[k][0] = (segment_t){1, 0, *next, 0};
    for (int i = 0; i < OPERATIONS; i++) {
        if (plan[i].of != "ab"[k] && plan[i].of != 'x') continue;
        w->places[*next - OPERATIONS] = i;
        w->operations[*next] = plan[i].op;
        if (plan[i].of == 'x') w->operations[*next].index = 1 + k, w->operations[*next].count = 0;
        (*next)++;
    }
    w->own[k][0].last = *next;
    part->n_segments = 1;
}

static void run(world_t *w, int parts)
{
    engine_t *e = &w->engine;
    int64_t next = OPERATIONS;

    for (int k = 0; k < 2; k++) {
        w->units[k] = (unit_t){.kind = UNIT_NATIVE,
                               .h = 1e-3,
                               .instance = w->x[k],
                               .step = (void *)swing,
                               .input = k ? B_IN : A_IN,
                               .input_count = 4,
                               .output = k ? B_OUT : A_OUT,
                               .output_count = 2,
                               .period = 1};
        w->senders[k] = (sender_t){w->history[k], 1, 0, CAPACITY};
        w->links[k] = (link_t){w->senders + k, w->table[k], w->initial + k, 0, TICKS, -1, 0};
        w->x[k][0] = 1.0 - k, w->x[k][1] = 0.5;
    }
    w->players[0] = (player_t){w->played, 0, TICKS};
    for (int i = 0; i < OPERATIONS; i++) w->operations[i] = plan[i].op;
    w->segments[0] = (segment_t){1, 0, 0, OPERATIONS};
    w->stretches[0] = (stretch_t){0, 0, N, 0, 0};
    w->stretches[1] = (stretch_t){0, 0, B_IN, 1, 0};
    w->stretches[2] = (stretch_t){B_IN, B_IN, N - B_IN, 1, 0};
    for (int i = 0; i < 3; i++) w->columns[i] = (columns_t){w->stretches + i, 1};
    for (int k = 0; k < 2; k++) set_part(w, k, &next);
    w->members[0].failed.operation = w->members[0].ended.operation = -1;
    w->team = (team_t){.parts = w->parts,
                       .places = w->places,
                       .members = w->members,
                       .n_parts = 2,
                       .n_plan = OPERATIONS,
                       .record = 2,
                       .longest = LEAST,
                       .threads = 1};
    *e = (engine_t){.operations = w->operations,
                    .segments = w->segments,
                    .units = w->units,
                    .links = w->links,
                    .senders = w->senders,
                    .players = w->players,
                    .signals = w->signals,
                    .record = w->rows,
                    .columns = w->columns,
                    .n_segments = 1,
                    .width = N,
                    .h = 1e-3,
                    .every = 1,
                    .team = parts ? &w->team : NULL};
    for (int64_t ticks = 1; e->tick < TICKS; ticks = ticks % 97 + 1) {
        const int64_t left = TICKS - e->tick;
        const int32_t result = engine_run(e, ticks < left ? ticks : left);
        if (result != RUN_OK) {
            printf("result %d at tick %lld\n", (int)result, (long long)e->tick);
            exit(1);
        }
        e->record = w->rows + e->tick * N, e->row = 0;
    }
}

static world_t worlds[2];

int main(void)
{
    world_t *w = worlds;
    for (int i = 0; i < TICKS; i++) {
        w->played[i] = number();
        for (int k = 0; k < 2; k++) w->table[k][i] = i - LEAST - (int32_t)(8.0 * (1.0 + number()));
    }
    w[1] = w[0];
    run(w, 0);
    run(w + 1, 1);
    for (int64_t i = 0; i < TICKS; i++) {
        take(w[0].rows + i * N, LAST);
        if (memcmp(w[0].rows + i * N, w[1].rows + i * N, LAST * sizeof(double))) {
            printf("parts differ at tick %lld\n", (long long)i);
            return 1;
        }
    }
    printf("%016llx\n", (unsigned long long)digest);
    return 0;
}
