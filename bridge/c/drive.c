/* drive.c: an emulated motor drive; see drive.h. */
#include "drive.h"

/* 1 - exp(-x), x >= 0, without libm: the same number everywhere. x = n ln 2 + r, |r| <= ln 2 / 2. */
static double decayed(double x)
{
    static const double LN2_HIGH = 0x1.62e42fefa3800p-1, LN2_LOW = 0x1.ef35793c76730p-45;
    if (!(x < 40.0)) return 1.0;
    const int n = (int)(x / LN2_HIGH + 0.5);
    const double r = x - n * LN2_HIGH - n * LN2_LOW;
    double term = 0.0, power = 1.0; /* term: 1 - exp(-r), by Horner */
    for (int k = 15; k >= 1; k--) term = r / k * (1.0 - term);
    for (int k = 0; k < n; k++) power *= 0.5;
    return (1.0 - power) + power * term;
}

/* The nearest multiple of lsb, halves to even; x itself where lsb is 0 or x is not finite. */
static double quantised(double x, double lsb)
{
    static const double ROUND = 0x1.8p52;
    if (!(lsb > 0.0)) return x;
    const double n = x / lsb;
    return n > -0x1p51 && n < 0x1p51 ? ((n + ROUND) - ROUND) * lsb : x;
}

static double within(const drive_t *d, int32_t i, double tau)
{
    if (!d->tau_max) return tau;
    const double limit = d->tau_max[i];
    return tau > limit ? limit : tau < -limit ? -limit : tau;
}

API int32_t drive_request(drive_t *d, int32_t request, int64_t now_ns)
{
    static const int32_t from[] = {-1, DRIVE_OFF, DRIVE_READY, DRIVE_ENABLED, DRIVE_FAULT, -1};
    static const int32_t to[] = {-1, DRIVE_READY, DRIVE_ENABLED, DRIVE_READY, DRIVE_READY, DRIVE_OFF};
    if (request < DRIVE_POWER_ON || request > DRIVE_TRIP) return d->state;
    if (request == DRIVE_TRIP) {
        d->faults += d->state == DRIVE_READY || d->state == DRIVE_ENABLED;
        if (d->state != DRIVE_OFF) d->state = DRIVE_FAULT;
        return d->state;
    }
    if (request != DRIVE_POWER_OFF && d->state != from[request]) return d->state;
    d->state = to[request];
    watchdog_reset(&d->watchdog, now_ns);
    for (int32_t i = 0; i < d->joints; i++) d->tau[i] = 0.0;
    return d->state;
}

static int all_finite(const double *x, int32_t n)
{
    for (int32_t i = 0; i < n; i++)
        if (x[i] - x[i] != 0.0) return 0;
    return 1;
}

/* The current loop follows the command: d tau/dt = (command - tau) / lag, exact for a command held
 * over h; what acts is the mean over h. */
static void follow(drive_t *d, const double *command, double *torque)
{
    const double x = d->lag > 0.0 ? d->h / d->lag : 1e9;
    const double a = decayed(x);
    const double mean = d->lag > 0.0 && x > 0.0 ? a / x : 0.0;
    for (int32_t i = 0; i < d->joints; i++) {
        const double target = quantised(within(d, i, command[i]), d->tau_lsb);
        const double behind = d->tau[i] - target;
        torque[i] = within(d, i, target + mean * behind);
        d->tau[i] = within(d, i, target + (1.0 - a) * behind);
    }
}

API void drive_step(drive_t *d, const double *command, int32_t valid, const double *dq, int64_t now_ns,
                    double *torque)
{
    if (valid) watchdog_feed(&d->watchdog, now_ns);
    if (d->state == DRIVE_ENABLED &&
        (watchdog_check(&d->watchdog, now_ns) || !all_finite(command, d->joints))) {
        d->state = DRIVE_FAULT;
        d->faults++;
    }
    if (d->state == DRIVE_ENABLED) {
        follow(d, command, torque);
        return;
    }
    const int damped = d->state == DRIVE_FAULT && d->damping > 0.0 && all_finite(dq, d->joints);
    for (int32_t i = 0; i < d->joints; i++) {
        d->tau[i] = 0.0;
        torque[i] = damped ? within(d, i, -d->damping * dq[i]) : 0.0;
    }
}

API void drive_measure(const drive_t *d, const double *q, const double *dq, double *q_out, double *dq_out)
{
    for (int32_t i = 0; i < d->joints; i++) {
        q_out[i] = quantised(q[i], d->q_lsb);
        dq_out[i] = quantised(dq[i], d->dq_lsb);
    }
}
