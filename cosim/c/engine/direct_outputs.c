/* direct_outputs.c: outputs with direct feed-through at the end of a macro step.
 *
 * Such an output depends on the input that is held, which is the one of the middle of the
 * step. So each sweep ends with a short step of such components from the end, b, with their inputs there, after
 * which they go back to b. They follow each other along their wires, and what the short step itself has changed
 * is taken away along the line from a.
 *
 * Where they wait for each other in a loop, their outputs are the solution of equations y = g(y), whatever the
 * length of the step. g(y) is one pass over the loop, and passes follow each other until y is known to a tenth
 * of the tolerance. What the next one takes is the combination of all passes that leaves the least residual, as
 * far as that is linear in it (Anderson 1965; Walker and Ni, SIAM J. Numer. Anal. 49, 2011): a linear loop whose
 * feedback has n scalars is solved after n + 1 passes, whether plain ones would converge or not. What the short
 * step changes is measured there, by one with the inputs of the middle of the step: the line knows it to a
 * thousandth of the change of y only, which a loop amplifies.
 */
#include "engine_internal.h"

enum { SHORT_STEP = 1024 }; /* a step over the short one at its end */

/* What the wires to one member carry now, and what its inputs were; or `back`, these. */
static void carry(const engine_t *e, const macro_t *m, const rollback_t *r, double *held, int back)
{
    double *s = e->signals;
    for (const operation_t *w = m->wires + r->wire; w < m->wires + r->wire + r->n_wires; w++) {
        copy(back ? s + w->target : held, back ? held : s + w->target, w->count);
        held += w->count;
        for (int64_t k = 0; k < w->count && !back && !w->index; k++)
            s[w->target + k] = w->gain * s[w->source + k] + w->offset;
    }
}

/* A step of length h/SHORT_STEP from t, after which the unit is where it was; its outputs stay. */
static int step_shortly(engine_t *e, rollback_t *r, int64_t tick, double t, double h, failure_t *failure)
{
    unit_t *u = e->units + r->unit;
    const double whole = u->h;
    int result;

    u->h = h / SHORT_STEP;
    result = step_from(e, tick, t, r->unit, failure);
    u->h = whole;
    if (result != RUN_OK && result != RUN_TERMINATED) return result;
    return move_state(e, r, MOVE_BACK_END, failure);
}

/* The outputs of one component for the inputs at the end, t, of a macro step of length h. */
static int finish_one(engine_t *e, macro_t *m, rollback_t *r, int64_t tick, double t, double h,
                      failure_t *failure)
{
    const macro_memory_t v = memory_of(m);
    const unit_t *u = e->units + r->unit;
    double *y = e->signals + u->output, *before = v.end + r->first;
    int result;

    carry(e, m, r, v.held + r->input, 0);
    copy(before, y, u->output_count);
    result = move_state(e, r, MOVE_SAVE_END, failure);
    if (result == RUN_OK) result = step_shortly(e, r, tick, t, h, failure);
    if (result != RUN_OK) return result;
    carry(e, m, r, v.held + r->input, 1);
    for (int64_t k = 0; k < u->output_count; k++)
        y[k] =
            r->roles[k] == ROLE_DIRECT ? y[k] - (y[k] - v.start[r->first + k]) / (SHORT_STEP + 1) : before[k];
    return RUN_OK;
}

typedef struct {
    double *taken, *found, *last_found, *residual, *last_residual, *scale;
    double *directions, *changes, *sizes; /* a row each pass: of the residual, of what was found */
} loop_memory_t;

static loop_memory_t memory_of_loop(const loop_t *l)
{
    double *at = l->memory;
    loop_memory_t v;
    v.taken = at, at += l->n_outputs;
    v.found = at, at += l->n_outputs;
    v.last_found = at, at += l->n_outputs;
    v.scale = at, at += l->n_outputs;
    v.residual = at, at += l->n_fed_back;
    v.last_residual = at, at += l->n_fed_back;
    v.changes = at, at += l->n_kept * l->n_outputs;
    v.directions = at, at += l->n_kept * l->n_fed_back;
    v.sizes = at;
    return v;
}

INLINE double dot(const double *a, const double *b, int64_t n)
{
    double sum = 0.0;
    for (int64_t i = 0; i < n; i++) sum += a[i] * b[i];
    return sum;
}

/* a -= factor * b */
INLINE void take_away(double *a, double factor, const double *b, int64_t n)
{
    for (int64_t i = 0; i < n; i++) a[i] -= factor * b[i];
}

/* How the residual has changed with the last pass, orthogonal to the directions before, and what was found
 * with it. All are forgotten once there are as many as there is memory for. */
static void keep_direction(loop_t *l, const loop_memory_t *v)
{
    const int64_t n = l->n_outputs, fed = l->n_fed_back;
    double *direction, *change, size;

    if (l->kept == l->n_kept) l->kept = 0;
    direction = v->directions + l->kept * fed;
    change = v->changes + l->kept * n;
    for (int64_t i = 0; i < fed; i++) direction[i] = v->residual[i] - v->last_residual[i];
    for (int64_t i = 0; i < n; i++) change[i] = v->found[i] - v->last_found[i];
    size = dot(direction, direction, fed) + dot(v->residual, v->residual, fed);
    for (int64_t k = 0; k < l->kept; k++) {
        const double along = dot(v->directions + k * fed, direction, fed) / v->sizes[k];
        take_away(direction, along, v->directions + k * fed, fed);
        take_away(change, along, v->changes + k * n, n);
    }
    v->sizes[l->kept] = dot(direction, direction, fed);
    if (v->sizes[l->kept] > 1e-20 * size) l->kept++;
}

/* The larger one of `most` and of the difference of two vectors, in tolerances; what is no number is infinite. */
static double larger(double most, const double *a, const double *b, const double *scale, int64_t n)
{
    for (int64_t i = 0; i < n; i++) {
        const double x = fabs(a[i] - b[i]) / scale[i];
        if (!(x <= most)) most = x == x ? x : HUGE_VAL;
    }
    return most;
}

/* What the next pass takes. Returns how far that and what was taken are from what was found, in tolerances. */
static double choose_taken(loop_t *l, int pass)
{
    const loop_memory_t v = memory_of_loop(l);
    const int64_t n = l->n_outputs, fed = l->n_fed_back;
    const double most = larger(0.0, v.found, v.taken, v.scale, n);

    for (int64_t i = 0; i < fed; i++) v.residual[i] = (v.found[i] - v.taken[i]) / v.scale[i];
    if (pass == 1) l->kept = 0;
    else keep_direction(l, &v);
    copy(v.taken, v.found, n);
    copy(v.last_residual, v.residual, fed);
    copy(v.last_found, v.found, n);
    for (int64_t k = 0; k < l->kept; k++) {
        const double along = dot(v.directions + k * fed, v.residual, fed) / v.sizes[k];
        take_away(v.residual, along, v.directions + k * fed, fed);
        take_away(v.taken, along, v.changes + k * n, n);
    }
    return larger(most, v.taken, v.found, v.scale, n);
}

/* A short step of each component of a loop with the inputs that it has: how much that alone changes. */
static int measure_drift(engine_t *e, macro_t *m, const loop_t *l, int64_t tick, double t, double h,
                         failure_t *failure)
{
    const macro_memory_t v = memory_of(m);

    for (const int32_t *i = l->members; i < l->members + l->n_members; i++) {
        rollback_t *r = m->members + *i;
        const unit_t *u = e->units + r->unit;
        double *y = e->signals + u->output, *drift = v.end + r->first;
        int result;
        if (r->ended) continue;
        copy(drift, y, u->output_count);
        result = move_state(e, r, MOVE_SAVE_END, failure);
        if (result == RUN_OK) result = step_shortly(e, r, tick, t, h, failure);
        if (result != RUN_OK) return result;
        for (int64_t k = 0; k < u->output_count; k++) {
            const double before = drift[k];
            if (r->roles[k] == ROLE_DIRECT) drift[k] = y[k] - before;
            y[k] = before;
        }
    }
    return RUN_OK;
}

/* One pass over a loop: each component for the outputs of those before it. */
static int pass_over(engine_t *e, macro_t *m, const loop_t *l, int64_t tick, double t, double h,
                     failure_t *failure)
{
    const macro_memory_t v = memory_of(m);

    for (const int32_t *i = l->members; i < l->members + l->n_members; i++) {
        rollback_t *r = m->members + *i;
        const unit_t *u = e->units + r->unit;
        double *y = e->signals + u->output;
        const double *drift = v.end + r->first;
        int result;
        if (r->ended) continue;
        carry(e, m, r, v.held + r->input, 0);
        result = step_shortly(e, r, tick, t, h, failure);
        if (result != RUN_OK) return result;
        carry(e, m, r, v.held + r->input, 1);
        for (int64_t k = 0; k < u->output_count; k++)
            y[k] = r->roles[k] == ROLE_DIRECT ? y[k] - drift[k] : drift[k];
    }
    return RUN_OK;
}

/* The outputs of components that wait for each other. `guess`: all outputs, where better ones than those that
 * they have are known, or NULL. */
static int finish_loop(engine_t *e, macro_t *m, loop_t *l, int64_t tick, double t, double h,
                       const double *guess, failure_t *failure)
{
    const macro_memory_t g = memory_of(m);
    const loop_memory_t v = memory_of_loop(l);
    double *s = e->signals;
    int result = measure_drift(e, m, l, tick, t, h, failure);

    if (result != RUN_OK) return result;
    for (int64_t i = 0; i < l->n_outputs; i++) {
        const double y = guess ? guess[l->places[i]] : s[l->outputs[i]];
        const double size = fabs(y) > g.largest[l->places[i]] ? fabs(y) : g.largest[l->places[i]];
        v.taken[i] = y;
        v.scale[i] = m->absolute + m->tolerance * size;
    }
    l->solved++;
    for (int pass = 1; pass <= LOOP_PASSES; pass++) {
        for (int64_t i = 0; i < l->n_outputs; i++) s[l->outputs[i]] = v.taken[i];
        result = pass_over(e, m, l, tick, t, h, failure);
        l->passes++;
        l->left = HUGE_VAL;
        if (result == RUN_NOT_FINITE && pass > 1) break; /* what it took was too large */
        if (result != RUN_OK) return result;
        for (int64_t i = 0; i < l->n_outputs; i++) v.found[i] = s[l->outputs[i]];
        l->left = choose_taken(l, pass);
        if (pass > 1 && 10.0 * l->left <= CONVERGED_TENTHS) return RUN_OK;
    }
    failure->index = m->members[l->members[0]].unit;
    failure->status = 0;
    return RUN_LOOP;
}

/* Outputs with direct feed-through for the inputs at the end, t, of a macro step of length h. */
SHARED int finish_outputs(engine_t *e, macro_t *m, int64_t tick, double t, double h, const double *guess,
                          failure_t *failure)
{
    loop_t *l = m->loops;
    int result = RUN_OK;

    for (const int32_t *i = m->direct; i < m->direct + m->n_direct && result == RUN_OK;) {
        rollback_t *r = m->members + *i;
        if (l < m->loops + m->n_loops && l->members == i) {
            result = finish_loop(e, m, l, tick, t, h, guess, failure);
            i += l->n_members;
            l++;
            continue;
        }
        if (!r->ended) result = finish_one(e, m, r, tick, t, h, failure);
        i++;
    }
    return result;
}
