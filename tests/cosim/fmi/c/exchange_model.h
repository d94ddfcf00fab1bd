/* An FMU for model exchange that keeps to the state machine (FMI 2.0.5, 3.2.3; 3.0.2, 3.2) and writes down
 * every call. exchange2.c and exchange3.c are its functions in both versions.
 *
 * A call that is not allowed in its state is written with "ILLEGAL" behind it, to the file that the
 * environment variable STRICT_CALLS names. Two states x, one indicator z or two, what they are is in `model`:
 *
 * BALL        falls with 9.81 m/s^2 and rebounds with 0.7 of its speed
 * GROWS       x0' = x0 cos t (the exponential of sin t), x1' = u
 * POL         van der Pol's oscillator with `mu`
 * STICKS      a mass on a spring and on a belt of 0.1 m/s: it sticks up to 1 N, and slips with 0.6 N
 * COUNTS      a time event each `period`; it ends the simulation after `last`
 * WRAPS       x0' = 1, taken back by 1 in the step after it is more than 1: a step event
 * FAILS       x0' = 1; derivatives return `status` from t = `when` on
 * SHRINKS     x0' = -100 x0; derivatives are discarded for x0 < 0
 * WALLS       x0' = x1 between walls at 0 and 1, two indicators: rebounds from both with the same speed
 * LEAVES      x0' = -1 from 1, indicator x0: comes to exactly 0 at 1 s, where steps of 2^-n end
 * FADES       x0' = 1, an event at x0 = `when` by an indicator that falls steeply first and is flat there
 * SWITCHES    x0' = 1, an event at x0 = `when` by an indicator that is 1 before and -1e-12 after
 * PASSES      x0' = 1, indicator mu x0: from 0 it stays in the domain "<= 0", or leaves it at once
 */
#include <float.h>
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define FMI __attribute__((visibility("default")))
enum { BALL, GROWS, POL, STICKS, COUNTS, WRAPS, FAILS, LEAVES, SHRINKS, WALLS, FADES, SWITCHES, PASSES };
enum { MADE = 1, STARTING = 2, IN_EVENT = 4, CONTINUOUS = 8, OVER = 16, BROKEN = 32, DEAD = 64 };
enum { X0, X1, DX0, DX1, U, MU, PERIOD, WHEN, AT, Z, MODEL = 20, STATUS, LAST, GEAR, EVENTS, HEARD };

typedef struct {
    double x[2], u, mu, period, when, at, t, latest, promised;
    int model, status, last, gear, events, heard, state, slips, stopped, evaluations, saved;
} fmu_t;

static int called(fmu_t *m, const char *name, int allowed)
{
    const char *path = getenv("STRICT_CALLS");
    FILE *file = path ? fopen(path, "a") : NULL;
    const int legal = (m->state & allowed) != 0;
    if (file) {
        fprintf(file, "%s%s\n", name, legal ? "" : " ILLEGAL");
        fclose(file);
    }
    return legal ? 0 : 3;
}

static fmu_t *made(void)
{
    fmu_t *m = calloc(1, sizeof *m);
    m->x[0] = 1.0, m->mu = 1.0, m->period = 0.25, m->when = 1e9, m->last = 1000, m->at = -1.0;
    m->state = MADE;
    called(m, "Instantiate", MADE);
    return m;
}

static double *real(fmu_t *m, uint32_t r)
{
    return r == X0 || r == X1 ? m->x + (r - X0)
           : r == U           ? &m->u
           : r == MU          ? &m->mu
           : r == PERIOD      ? &m->period
           : r == WHEN        ? &m->when
                              : &m->at;
}
static int *whole(fmu_t *m, uint32_t r)
{
    return r == MODEL    ? &m->model
           : r == STATUS ? &m->status
           : r == LAST   ? &m->last
           : r == GEAR   ? &m->gear
           : r == EVENTS ? &m->events
                         : &m->heard;
}

static void rates(const fmu_t *m, double *d)
{
    const double x = m->x[0], v = m->x[1];
    d[0] = v, d[1] = 0.0;
    switch (m->model) {
    case BALL: d[0] = m->stopped ? 0.0 : v, d[1] = m->stopped ? 0.0 : -9.81; break;
    case GROWS: d[0] = x * cos(m->t), d[1] = m->u; break;
    case POL: d[1] = m->mu * (1.0 - x * x) * v - x; break;
    case STICKS: d[0] = m->slips ? v : 0.1, d[1] = m->slips ? 0.6 - x : 0.0; break;
    case LEAVES: d[0] = -1.0; break;
    case WALLS: break;
    case SHRINKS: d[0] = -100.0 * x; break;
    default: d[0] = 1.0;
    }
}
static double fading(double x)
{
    const double y = 400.0 * x * x;
    return 1.0 / (1.0 + y * y);
}
static double indicator(const fmu_t *m)
{
    switch (m->model) {
    case BALL: return m->x[0] + (m->stopped ? 1.0 : 0.0);
    case STICKS: return m->slips ? 0.1 - m->x[1] + 1e-13 : 1.0 - m->x[0];
    case WALLS: return m->x[0];
    case FADES: return m->events ? 1.0 : fading(m->x[0]) - fading(m->when);
    case SWITCHES: return m->events || m->x[0] < m->when ? 1.0 : -1e-12;
    case PASSES: return m->mu * m->x[0];
    case LEAVES: return m->x[0] == 0.0 && m->events ? -DBL_MIN : m->x[0];
    default: return 1.0;
    }
}

static double other_indicator(const fmu_t *m) { return m->model == WALLS ? 1.0 - m->x[0] : 1.0; }

/* The event at m->t; returns whether states have changed. */
static int happens(fmu_t *m)
{
    const double z = indicator(m);
    if (m->model == COUNTS && m->t >= m->latest + m->period) {
        m->events++, m->at = m->t, m->latest += m->period;
    } else if (m->model == WRAPS && m->x[0] > 1.0) {
        m->x[0] -= 1.0, m->events++, m->at = m->t;
        return 1;
    } else if (m->model == WALLS && (z <= 0.0 || other_indicator(m) <= 0.0)) {
        m->x[0] = z <= 0.0 ? DBL_MIN : 1.0 - DBL_EPSILON, m->x[1] *= -1.0;
        m->events++, m->at = m->t;
        return 1;
    } else if ((m->model == FADES || m->model == SWITCHES) && z <= 0.0) {
        m->events++, m->at = m->t;
    } else if ((m->model == BALL || m->model == STICKS || m->model == LEAVES) && z <= 0.0) {
        if (m->model == LEAVES && m->events) return 0;
        m->events++, m->at = m->t;
        if (m->model == BALL) {
            m->x[0] = DBL_MIN, m->x[1] *= -0.7;
            m->stopped = m->x[1] < 0.1;
        }
        if (m->model == STICKS) m->slips = !m->slips, m->x[1] = 0.1;
        return 1;
    }
    return 0;
}

static int begins(fmu_t *m, double t0)
{
    m->t = m->latest = t0;
    if (m->model == STICKS) m->x[1] = 0.1;
    return 0;
}
/* Allowed before a state is at its end, and no longer afterwards. */
static int mode(fmu_t *m, const char *name, int allowed, int next)
{
    const int result = called(m, name, allowed);
    m->state = next;
    return result;
}
static int set_time(fmu_t *m, double t)
{
    if (t < m->at) return called(m, "SetTime before the last event", 0);
    m->t = t;
    return called(m, "SetTime", CONTINUOUS);
}
static int set_states(fmu_t *m, const double *x)
{
    m->x[0] = x[0], m->x[1] = x[1];
    return called(m, "SetContinuousStates", CONTINUOUS);
}
static int get_states(fmu_t *m, double *x)
{
    x[0] = m->x[0], x[1] = m->x[1];
    return called(m, "GetContinuousStates", STARTING | IN_EVENT | CONTINUOUS | OVER);
}
static int derivatives(fmu_t *m, double *d)
{
    rates(m, d);
    m->evaluations++;
    if (m->model == FAILS && m->t >= m->when) {
        called(m, "Derivatives", CONTINUOUS);
        if (m->status >= 3) m->state = m->status == 4 ? DEAD : BROKEN;
        return m->status;
    }
    if (m->model == SHRINKS && m->x[0] < 0.0) return 2;
    return called(m, "Derivatives", STARTING | IN_EVENT | CONTINUOUS | OVER);
}
static int directional(fmu_t *m, const uint32_t *unknowns, const uint32_t *knowns, size_t n,
                       const double *seed, double *found)
{
    const double x = m->x[0], v = m->x[1];
    const double rows[2][2] = {{0.0, 1.0}, {-2.0 * m->mu * x * v - 1.0, m->mu * (1.0 - x * x)}};
    for (size_t i = 0; i < n; i++) {
        found[i] = 0.0;
        for (size_t j = 0; j < n; j++) found[i] += rows[unknowns[i] - DX0][knowns[j] - X0] * seed[j];
    }
    return called(m, "DirectionalDerivative", STARTING | IN_EVENT | CONTINUOUS | OVER);
}
static int get_real(fmu_t *m, const uint32_t *r, size_t n, double *v)
{
    double d[2];
    rates(m, d);
    for (size_t i = 0; i < n; i++)
        v[i] = r[i] == DX0 || r[i] == DX1 ? d[r[i] - DX0] : r[i] == Z ? indicator(m) : *real(m, r[i]);
    return called(m, "GetReal", STARTING | IN_EVENT | CONTINUOUS | OVER);
}
/* Inputs that jump are set in Event Mode, parameters and start values before. */
static int set_real(fmu_t *m, const uint32_t *r, size_t n, const double *v)
{
    for (size_t i = 0; i < n; i++) {
        *real(m, r[i]) = v[i];
        if (called(m, "SetReal", r[i] == U ? MADE | STARTING | IN_EVENT : MADE | STARTING)) return 3;
    }
    return 0;
}
static int get_whole(fmu_t *m, uint32_t r, int *v)
{
    *v = *whole(m, r);
    return called(m, "GetWhole", STARTING | IN_EVENT | CONTINUOUS | OVER);
}
static int set_whole(fmu_t *m, uint32_t r, int v)
{
    *whole(m, r) = v;
    return called(m, "SetWhole", r == GEAR ? MADE | STARTING | IN_EVENT : MADE | STARTING);
}
