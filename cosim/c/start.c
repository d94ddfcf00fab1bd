/* start.c: the start of components: the calls that enter Initialization Mode, ask for outputs, and leave it.
 *
 * C makes the calls of one component after the other. It returns to Python for a call that C cannot make
 * (START_OTHER), to report a call that failed (START_REFUSED), or to judge values that were read back and differ
 * from those that were set (START_DIFFERENT). Python then does its part, moves `call` past that call, and calls the
 * same function again, which continues there (component `at`). The state is in start_t; nothing is allocated.
 */
#include "start.h"

typedef int (*setup2_t)(void *, int, double, double, int, double);
typedef int (*enter3_t)(void *, _Bool, double, double, _Bool, double);

static void *values_of(const start_t *s, const starting_t *x, const start_call_t *call)
{
    if (call->values == VALUES_EQUAL) return s->room;
    if (call->values == VALUES_ROW) return (char *)x->row + call->place;
    return (char *)(s->signals + (call->output ? x->output : x->input)) + call->place;
}

static int status_of(const start_t *s, const starting_t *x, const start_call_t *call)
{
    const size_t n = (size_t)call->n_references;
    switch (call->form) {
    case FORM_MODE: return ((mode_t3)call->function)(x->instance);
    case FORM_SETUP2:
        return ((setup2_t)call->function)(x->instance, call->has_tolerance, call->tolerance, s->begin, 0,
                                          0.0);
    case FORM_ENTER3:
        return ((enter3_t)call->function)(x->instance, call->has_tolerance != 0, call->tolerance, s->begin, 0,
                                          0.0);
    case FORM_VALUES2:
        return ((access2_t)call->function)(x->instance, call->references, n, values_of(s, x, call));
    case FORM_VALUES3:
        return ((access3_t)call->function)(x->instance, call->references, n, values_of(s, x, call),
                                           (size_t)call->n_values);
    default: return 0;
    }
}

/* Whether the values that were got are those of the row; numbers are compared as such: 0 equals -0. */
static int equal(const start_t *s, const starting_t *x, const start_call_t *call)
{
    const char *wanted = x->row + call->place;
    if (call->number == NUMBER_WHOLE) return !memcmp(s->room, wanted, (size_t)call->bytes);
    for (int64_t i = 0; i < call->n_values; i++) {
        if (call->number == NUMBER_DOUBLE ? ((const double *)s->room)[i] != ((const double *)wanted)[i]
                                          : ((const float *)s->room)[i] != ((const float *)wanted)[i])
            return 0;
    }
    return 1;
}

/* The rest of a component's calls in a stage. */
static int32_t calls_of(start_t *s, int64_t component, int32_t stage)
{
    const starting_t *x = s->components + component;
    const int64_t end = x->kind->first[stage + 1] - x->kind->first[stage];

    for (; s->call < end; s->call++) {
        const start_call_t *call = x->kind->calls + x->kind->first[stage] + s->call;
        if (call->form == FORM_OTHER) return START_OTHER;
        s->status = status_of(s, x, call);
        if ((unsigned)s->status > 1u) return START_REFUSED;
        if (call->values == VALUES_EQUAL && !equal(s, x, call)) return START_DIFFERENT;
    }
    return START_DONE;
}

static void keep_outputs(start_t *s, const starting_t *x)
{
    memcpy(s->before + x->output, s->signals + x->output, (size_t)x->n_outputs * sizeof(double));
}

/* Whether the outputs differ from those that keep_outputs kept. If so, the components that they feed are marked to be
 * asked: in this pass those with greater numbers, the others in the next one; while components leave, all in the
 * next one. */
static int changes_others(start_t *s, int64_t i)
{
    const starting_t *x = s->components + i;
    if (!memcmp(s->before + x->output, s->signals + x->output, (size_t)x->n_outputs * sizeof(double)))
        return 0;
    for (int64_t k = s->first_fed[i]; k < s->first_fed[i + 1]; k++)
        (s->leaving || s->feeds[k] <= i ? s->stale : s->waiting)[s->feeds[k]] = 1;
    return 1;
}

/* Bring values to the inputs of a component; whether it has to say its outputs for them. */
static int has_new_inputs(start_t *s, int64_t i)
{
    const starting_t *x = s->components + i;
    const size_t bytes = (size_t)x->n_inputs * sizeof(double);

    for (int64_t k = s->fed[i]; k < s->fed[i + 1]; k++) {
        const bringing_t *b = s->bringing + k;
        double *target = s->signals + b->target;
        const double *source = s->signals + b->source;
        for (int64_t j = 0; j < b->count; j++)
            target[j] = b->initial ? b->initial[j] : b->gain * source[j] + b->offset;
    }
    if (s->asked[i] && !memcmp(s->known + x->input, s->signals + x->input, bytes)) return 0;
    memcpy(s->known + x->input, s->signals + x->input, bytes);
    s->asked[i] = 1;
    s->changed = 1;
    return s->unsettled[i];
}

static int all_finite(const double *x, int64_t n)
{
    for (int64_t i = 0; i < n; i++)
        if (!isfinite(x[i])) return 0;
    return 1;
}

static int32_t say(start_t *s, int64_t i)
{
    const starting_t *x = s->components + i;
    if (!s->saying) {
        if (!has_new_inputs(s, i)) return START_DONE;
        keep_outputs(s, x);
        s->saying = 1;
        s->call = 0;
        /* Python has a message for what is no number */
        if (!all_finite(s->signals + x->input, x->n_inputs)) return START_OTHER;
    }
    const int32_t result = calls_of(s, i, STAGE_SAY);
    if (result != START_DONE) return result;
    s->saying = 0;
    changes_others(s, i);
    return START_DONE;
}

/* One stage, STAGE_ENTER or STAGE_LEAVE, of all components. In STAGE_LEAVE it returns START_CHANGED after each
 * component whose outputs changed, so that Python can pass them on. */
API int32_t engine_start(start_t *s, int32_t stage)
{
    s->leaving = stage == STAGE_LEAVE;
    for (; s->at < s->n; s->at++, s->call = 0) {
        const int64_t i = s->leaving ? s->order[s->at] : s->at;
        if (s->leaving && !s->call && s->unsettled[i]) {
            s->unsettled[i] = 0;
            keep_outputs(s, s->components + i);
        }
        const int32_t result = calls_of(s, i, stage);
        if (result != START_DONE) return result;
        if (s->leaving && changes_others(s, i)) {
            s->at++;
            s->call = 0;
            return START_CHANGED;
        }
    }
    return START_DONE;
}

/* Pass values on, component after component, until none changes: `at` = -1 begins. At most once more than there
 * are components. */
API int32_t engine_settle(start_t *s)
{
    s->leaving = 0;
    for (;;) {
        if (s->at < 0) {
            memcpy(s->waiting, s->stale, (size_t)s->n);
            memset(s->stale, 0, (size_t)s->n);
            s->changed = s->saying = 0;
            s->at = 0;
        }
        for (; s->at < s->n; s->at++) {
            if (!s->saying && !s->waiting[s->at]) continue;
            s->waiting[s->at] = 0;
            const int32_t result = say(s, s->at);
            if (result != START_DONE) return result;
        }
        if (!s->changed) return START_DONE;
        if (++s->passes > s->n) return START_RESTLESS;
        s->at = -1;
    }
}
