/* macro_steps.c: components that exchange values several times in a period, as often as a tolerance needs.
 *
 * A period is divided into macro steps; each is the period divided by a power of two, so
 * that time stays a whole number (of the smallest steps) and every sampling instant is the end of one. A
 * macro step from a to b is done at least twice, from the same state: in the first sweep the inputs hold
 * their values u_a, in the others they are (u_a + u_b)/2, with u_b from the sweep before. These are the
 * Euler method and the trapezoidal rule for the coupling, of orders one and two: the difference of their
 * outputs is the estimate of the error, and the second is kept (Hairer, Norsett, Wanner, Solving Ordinary
 * Differential Equations I, II.4).
 *
 * Outputs with direct feed-through are those of the end of a step by direct_outputs.c, at the end of each sweep.
 */
#include "engine_internal.h"

enum { FETCH, PUT_BACK }; /* of outputs */

/* One sweep: a step of all, or of those with inputs from the others. */
static int sweep(engine_t *e, macro_t *m, int64_t tick, double t, double h, int coupled, failure_t *failure)
{
    for (int64_t i = 0; i < m->n_members; i++) {
        rollback_t *r = m->members + i;
        unit_t *u = e->units + r->unit;
        const double whole = u->h;
        int result;
        if (r->coupled < coupled) continue;
        u->h = h;
        result = step_from(e, tick, t, r->unit, failure);
        u->h = whole;
        r->ended = result == RUN_TERMINATED;
        if (result != RUN_OK && result != RUN_TERMINATED) return result;
    }
    return RUN_OK;
}

/* Outputs of the members to one vector, or back. */
static void move_outputs(const engine_t *e, const macro_t *m, double *vector, int back)
{
    for (int64_t i = 0; i < m->n_members; i++) {
        const unit_t *u = e->units + m->members[i].unit;
        double *at = e->signals + u->output;
        copy(back ? at : vector, back ? vector : at, u->output_count);
        vector += u->output_count;
    }
}

/* What the wires carry at the start of a macro step. */
static void take_inputs(const engine_t *e, const macro_t *m, double *inputs, int newer)
{
    double *s = e->signals;
    for (int64_t i = 0; i < m->n_wires; inputs += m->wires[i].count, i++) {
        const operation_t *w = m->wires + i;
        for (int64_t k = 0; k < w->count && newer; k++)
            s[w->target + k] = w->gain * s[w->source + k] + w->offset;
        copy(inputs, s + w->target, w->count);
    }
}

/* The means of that and of what they carry now; or, `held`, that itself. */
static void set_inputs_between(const engine_t *e, const macro_t *m, const double *inputs, int held)
{
    double *s = e->signals;
    for (int64_t i = 0; i < m->n_wires; inputs += m->wires[i].count, i++) {
        const operation_t *w = m->wires + i;
        for (int64_t k = 0; k < w->count; k++) {
            const double end = w->gain * s[w->source + k] + w->offset;
            s[w->target + k] = held || w->index ? inputs[k] : 0.5 * (inputs[k] + end);
        }
    }
}

/* The largest difference of the outputs from `others`, in tolerances. */
static double distance(const engine_t *e, const macro_t *m, const macro_memory_t *v, const double *others)
{
    double most = 0.0;
    int64_t n = 0;
    for (int64_t i = 0; i < m->n_members; i++) {
        const rollback_t *r = m->members + i;
        const unit_t *u = e->units + r->unit;
        const double *y = e->signals + u->output;
        for (int64_t k = 0; k < u->output_count; k++, n++) {
            const double size = fabs(y[k]) > v->largest[n] ? fabs(y[k]) : v->largest[n];
            const double error = fabs(y[k] - others[n]) / (m->absolute + m->tolerance * size);
            if (r->roles[k] == ROLE_COUNTED && error > most) most = error;
        }
    }
    return most;
}

#define FORGOTTEN 0.01 /* of the largest value of an output, in a macro step */

/* One macro step, whatever its error: that in *error. Sweeps that do not converge count as an error, too. */
static int try_macro(engine_t *e, macro_t *m, int64_t tick, double t, double h, double *error,
                     failure_t *failure)
{
    const macro_memory_t v = memory_of(m);
    int result = sweep(e, m, tick, t, h, 0, failure);

    if (result == RUN_OK) result = finish_outputs(e, m, tick, t + h, h, NULL, failure);
    if (result != RUN_OK) return result;
    move_outputs(e, m, v.first, FETCH);
    for (int i = 1;; i++) {
        double change;
        move_outputs(e, m, v.last, FETCH);
        set_inputs_between(e, m, v.inputs, 0);
        result = move_states(e, m, MOVE_BACK, 1, failure);
        if (result == RUN_OK) result = sweep(e, m, tick, t, h, 1, failure);
        if (result == RUN_OK) result = finish_outputs(e, m, tick, t + h, h, v.last, failure);
        if (result != RUN_OK) return result;
        *error = distance(e, m, &v, v.first);
        if (m->iterations == 1) return RUN_OK;
        change = distance(e, m, &v, v.last);
        if (10.0 * change <= CONVERGED_TENTHS) return RUN_OK;
        if (i < m->iterations) continue;
        if (change > *error) *error = change;
        return RUN_OK;
    }
}

/* Failures of a trial step that a shorter one may not have. */
static int may_shorten(int result, const failure_t *failure)
{
    return result == RUN_NOT_FINITE || result == RUN_SOLVER || result == RUN_ENDED || result == RUN_LOOP ||
           (result == RUN_STEP && failure->status == REFUSED);
}

static void count_bonds(const engine_t *e, const macro_t *m, const double *start, double h)
{
    double *s = e->signals;
    for (int64_t i = 0; i < m->n_bonds; i++) {
        const bond_t *b = m->bonds + i;
        const double *effort = start + b->effort_start, *flow = start + b->flow_start;
        double power = 0.0;
        for (int64_t k = 0; k < b->count; k++) {
            const double e_mean = 0.5 * (effort[k] + s[b->effort + k]);
            const double f_mean = 0.5 * (flow[k] + s[b->flow + k]);
            power += s[b->effort_input + k] * f_mean / b->effort_gain -
                     e_mean * s[b->flow_input + k] / b->flow_gain;
        }
        s[b->residual] += h * power;
    }
}

/* The level of the step after an accepted one, at the whole number `at`: the error is expected to go on as it
 * did from the step before (a proportional and an integral part, as Gustafsson 1991), in steps of two. */
static void choose_level(macro_t *m, int64_t at, double error)
{
    double before = m->error, expected = error;

    for (int k = m->error_level; k > m->level; k--) before *= 4.0;
    for (int k = m->error_level; k < m->level; k++) before *= 0.25;
    if (before > 0.0 && error > before) expected = error * (error < 2.0 * before ? error / before : 2.0);
    m->error = error;
    m->error_level = m->level;
    if (expected > 1.0 && m->level < m->halvings) {
        m->level++;
    } else if (4.0 * expected <= 0.8 && m->level > 0 && !m->repeated &&
               at % ((int64_t)2 << (m->halvings - m->level)) == 0) {
        m->level--;
    }
    m->repeated = 0;
}

/* The level at which a step with too large an error is done again. */
static void shorten(macro_t *m, double error)
{
    m->rejected[m->level]++;
    do {
        m->level++;
        error *= 0.25;
    } while (error > 0.8 && m->level < m->halvings);
    m->repeated = 1;
}

/* The step that was done is kept. */
static int accept(engine_t *e, macro_t *m, double t, double h, double error, failure_t *failure)
{
    const macro_memory_t v = memory_of(m);
    int result = RUN_OK;
    int64_t n = 0;

    for (int64_t i = 0; i < m->n_members; i++) {
        const rollback_t *r = m->members + i;
        const unit_t *u = e->units + r->unit;
        for (int64_t k = 0; k < u->output_count; k++, n++) {
            const double size = fabs(e->signals[u->output + k]);
            v.largest[n] *= 1.0 - FORGOTTEN;
            if (size > v.largest[n]) v.largest[n] = size;
        }
        if (!r->ended) continue;
        failure->index = r->unit;
        failure->status = 0;
        result = RUN_TERMINATED;
    }
    count_bonds(e, m, v.start, h);
    m->accepted[m->level]++;
    if (error > m->worst) m->worst = error;
    if (error > 1.0 && !m->forced++) m->forced_at = t;
    e->signals[m->steps] += 1.0;
    if (h < e->signals[m->size]) e->signals[m->size] = h;
    return result;
}

/* A macro step from t, with as many trials as it needs; *h becomes its length. */
static int do_macro(engine_t *e, macro_t *m, int64_t tick, double t, double length, int first,
                    failure_t *failure, double *error)
{
    const macro_memory_t v = memory_of(m);
    int result = move_states(e, m, MOVE_SAVE, 0, failure);

    if (result != RUN_OK) return result;
    move_outputs(e, m, v.start, FETCH);
    take_inputs(e, m, v.inputs, !first);
    for (;;) {
        const double h = length / (double)((int64_t)1 << m->level);
        int back;
        result = try_macro(e, m, tick, t, h, error, failure);
        if (result != RUN_OK && !may_shorten(result, failure)) return result;
        if (m->level == m->halvings || (result == RUN_OK && *error <= 1.0)) break;
        e->signals[m->rejections] += 1.0;
        shorten(m, result == RUN_OK ? *error : 1.0);
        back = move_states(e, m, MOVE_BACK, 0, failure);
        if (back != RUN_OK) return back;
        move_outputs(e, m, v.start, PUT_BACK);
        set_inputs_between(e, m, v.inputs, 1);
    }
    if (result != RUN_OK) return result;
    return accept(e, m, t, length / (double)((int64_t)1 << m->level), *error, failure);
}

/* One period of all members. An FMU that ends the simulation ends it after the macro step it does so in. */
SHARED int run_macro(engine_t *e, int64_t tick, macro_t *m, failure_t *failure)
{
    const int64_t whole = (int64_t)1 << m->halvings;
    const double start = time_of(e, tick - m->period + 1), length = (double)m->period * e->h;
    int64_t at = 0;
    int result = RUN_OK;

    e->signals[m->steps] = e->signals[m->rejections] = 0.0;
    e->signals[m->size] = length;
    for (int64_t i = 0; i < m->n_bonds; i++) e->signals[m->bonds[i].residual] = 0.0;
    while (at < whole && result == RUN_OK) {
        const double t = start + length * ((double)at / (double)whole);
        double error = 0.0;
        result = do_macro(e, m, tick, t, length, at == 0, failure, &error);
        at += (int64_t)1 << (m->halvings - m->level);
        if (result == RUN_OK) choose_level(m, at, error);
    }
    for (int64_t i = 0; i < m->n_bonds; i++) {
        bond_t *b = m->bonds + i;
        const double energy = e->signals[b->residual];
        b->total += energy;
        if (fabs(energy) > b->largest) b->largest = fabs(energy);
    }
    return result;
}
