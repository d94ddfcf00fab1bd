/* floor.c - the loop somebody writes in C who has these FMUs and nothing else to do.
 *
 * Set, step, get and copies over one vector of signals, rows kept in memory: what no co-simulation
 * master can be faster than. Written apart from the engine that is measured against it; it checks
 * the status of every call and nothing else.
 */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

typedef int set2_t(void *, const uint32_t *, size_t, const double *);
typedef int get2_t(void *, const uint32_t *, size_t, double *);
typedef int step2_t(void *, double, double, int);
typedef int set3_t(void *, const uint32_t *, size_t, const double *, size_t);
typedef int get3_t(void *, const uint32_t *, size_t, double *, size_t);
typedef int step3_t(void *, double, double, _Bool, _Bool *, _Bool *, _Bool *, double *);

typedef int mode3_t(void *);
typedef int update3_t(void *, _Bool *, _Bool *, _Bool *, _Bool *, _Bool *, double *);

typedef struct {
    void *instance, *set, *step, *get;
    void *enter_event, *update, *enter_step; /* FMI 3.0, or NULL: events are ignored */
    double next_event;                       /* s, the next one that it has announced; or infinity */
    const uint32_t *inputs, *outputs;        /* value references */
    size_t n_inputs, n_outputs;
    double *u, *y;   /* in the vector of signals */
    size_t n_u, n_y; /* scalars */
} fmu_t;

typedef struct {
    const double *from;
    double *to;
    size_t n;
} copy_t;

typedef struct {
    fmu_t *fmus;
    copy_t *copies;
    double *signals, *rows; /* rows: NULL, or a place for one row a tick */
    int64_t n_fmus, n_copies, n_signals, tick;
    double h;
} loop_t;

static int step2(const fmu_t *f, double t, double h)
{
    if (f->n_inputs && ((set2_t *)f->set)(f->instance, f->inputs, f->n_inputs, f->u) > 1) return 1;
    if (((step2_t *)f->step)(f->instance, t, h, 1) > 1) return 1;
    return ((get2_t *)f->get)(f->instance, f->outputs, f->n_outputs, f->y) > 1;
}

/* Event Mode, from Step Mode and back. */
static int handle_event(fmu_t *f)
{
    _Bool again = 1, terminate, nominals, values, defined;
    double next;
    if (((mode3_t *)f->enter_event)(f->instance) > 1) return 1;
    while (again) {
        if (((update3_t *)f->update)(f->instance, &again, &terminate, &nominals, &values, &defined, &next) >
            1)
            return 1;
        if (terminate) return 1;
    }
    f->next_event = defined ? next : HUGE_VAL;
    return ((mode3_t *)f->enter_step)(f->instance) > 1;
}

/* A step as FMI 3.0 demands it (2.3.5, 4.2.1): until its time is reached, and with the events in it. */
static int step_events3(fmu_t *f, double t, double h)
{
    const double end = t + h, slack = 1e-9 * h;
    double now = t, length = h;
    if (f->n_inputs && ((set3_t *)f->set)(f->instance, f->inputs, f->n_inputs, f->u, f->n_u) > 1) return 1;
    for (;;) {
        const double to = f->next_event < end - slack ? f->next_event : end;
        _Bool event, terminate, early;
        double last;
        if (to != end) length = to - now;
        if (((step3_t *)f->step)(f->instance, now, length, 1, &event, &terminate, &early, &last) > 1)
            return 1;
        if (terminate) return 1;
        now = early ? last : to;
        if (f->enter_event && (event || f->next_event <= now + slack) && handle_event(f)) return 1;
        if (now >= end - slack) break;
        length = end - now;
    }
    return ((get3_t *)f->get)(f->instance, f->outputs, f->n_outputs, f->y, f->n_y) > 1;
}

static int step3(const fmu_t *f, double t, double h)
{
    _Bool event, terminate, early;
    double last;
    if (f->n_inputs && ((set3_t *)f->set)(f->instance, f->inputs, f->n_inputs, f->u, f->n_u) > 1) return 1;
    if (((step3_t *)f->step)(f->instance, t, h, 1, &event, &terminate, &early, &last) > 1) return 1;
    return ((get3_t *)f->get)(f->instance, f->outputs, f->n_outputs, f->y, f->n_y) > 1;
}

static void copy(const copy_t *c)
{
    for (size_t i = 0; i < c->n; i++) c->to[i] = c->from[i];
}

static void keep_row(loop_t *l)
{
    if (l->rows == NULL) return;
    memcpy(l->rows, l->signals, (size_t)l->n_signals * sizeof(double));
    l->rows += l->n_signals;
}

/* `ticks` ticks of a few FMUs that all step together; 1 where a call failed. `version`: 2, 3, or 4: FMI 3.0 with events. */
EXPORT int floor_run(loop_t *l, int version, int64_t ticks)
{
    for (const int64_t end = l->tick + ticks; l->tick < end; l->tick++) {
        const double t = (double)l->tick * l->h;
        keep_row(l);
        for (int64_t i = 0; i < l->n_copies; i++) copy(l->copies + i);
        for (int64_t i = 0; i < l->n_fmus; i++)
            if (version == 4   ? step_events3(l->fmus + i, t, l->h)
                : version == 3 ? step3(l->fmus + i, t, l->h)
                               : step2(l->fmus + i, t, l->h))
                return 1;
    }
    return 0;
}

/* Two arms every tick, two controllers every `every` ticks, each given what the other sent some
 * time ago. FMUs: the controllers, then the arms; copies: controllers' inputs, then arms'. */
typedef struct {
    loop_t loop;
    const double *sent_from[2]; /* what a controller sends */
    double *held_at[2];         /* where it finds what it was sent */
    double *sent[2];            /* (1 + hits, n) what was there before, then all it ever sent */
    const int32_t *held[2];     /* (hits,) which of the other's samples it holds, -1: the first */
    int64_t n, every;
} pair_t;

EXPORT int floor_teleoperation(pair_t *p, int version, int64_t ticks)
{
    loop_t *l = &p->loop;
    const size_t bytes = (size_t)p->n * sizeof(double);
    const double h = (double)p->every * l->h;
    int failed = 0;
    for (const int64_t end = l->tick + ticks; l->tick < end && !failed; l->tick++) {
        const double t = (double)l->tick * l->h;
        if (l->tick % p->every == 0) {
            const int64_t hit = l->tick / p->every;
            for (int64_t i = 0; i < l->n_copies / 2; i++) copy(l->copies + i);
            for (int i = 0; i < 2; i++) {
                memcpy(p->held_at[i], p->sent[1 - i] + (1 + p->held[i][hit]) * p->n, bytes);
                failed |= version == 3 ? step3(l->fmus + i, t, h) : step2(l->fmus + i, t, h);
                memcpy(p->sent[i] + (1 + hit) * p->n, p->sent_from[i], bytes);
            }
        }
        keep_row(l);
        for (int64_t i = l->n_copies / 2; i < l->n_copies; i++) copy(l->copies + i);
        for (int i = 2; i < 4; i++)
            failed |= version == 3 ? step3(l->fmus + i, t, l->h) : step2(l->fmus + i, t, l->h);
    }
    return failed;
}

EXPORT size_t floor_sizes(int which)
{
    static const size_t sizes[] = {sizeof(fmu_t), sizeof(copy_t), sizeof(loop_t), sizeof(pair_t)};
    return sizes[which];
}
