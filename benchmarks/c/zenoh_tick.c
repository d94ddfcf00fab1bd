/* zenoh_tick.c: a tick in C at one end of a bus, as a node has it, for benchmarks/zenoh_*.py.
 *
 * Messages have four values: number, when it was sent (ns), and two more. What is sent is encoded and
 * protected, what comes in is checked and decoded. Linked against the bridge's library.
 */
#include <errno.h>

#include "bus.h"
#include "mail.h"
#include "message.h"
#include "pace.h"

enum { VALUES = 4, PATIENCE_NS = 2000000000, LOOK_NS = 10000000 };

/* What one tick did, ns: how late it woke, what bus_send took, and of the newest sample it held its
 * number (-1: none yet), when that was sent, and when it arrived. */
typedef struct {
    int64_t late, paid, number, sent, arrived;
} tick_t;

static int32_t say(bus_t *bus, const message_t *m, int64_t number, int64_t sent_ns)
{
    const double values[VALUES] = {(double)number, (double)sent_ns};
    header_t header = {.counter = (uint32_t)number};
    frame_t frame;

    message_encode(m, values, &header, &frame);
    frame.t_ns = sent_ns;
    return bus_send(bus, &frame);
}

/* The next good frame of this message: 1, values and when it arrived; 0: none. */
static int32_t heard(bus_t *bus, const message_t *m, double *values, int64_t *arrived)
{
    header_t header;
    frame_t frame;

    while (bus_receive(bus, &frame)) {
        if (frame.id != m->id || message_decode(m, &frame, values, &header) != DECODE_OK) continue;
        *arrived = frame.t_ns;
        return 1;
    }
    return 0;
}

/* As heard, waits for it as lock-step does; 0: none within two seconds, or *stop. */
static int32_t await(bus_t *bus, const message_t *m, double *values, const volatile int32_t *stop)
{
    const int64_t end = pace_now() + PATIENCE_NS;
    int64_t arrived;

    while (!heard(bus, m, values, &arrived)) {
        const int64_t now = pace_now();
        if (now > end || (stop && *stop)) return 0;
        mail_wait(bus->rx, now + LOOK_NS);
    }
    return 1;
}

/* n round trips, taken[k] ns; 0, or an errno. A ping that does not come back is ETIMEDOUT. */
API int32_t tick_ping(bus_t *bus, const message_t *out, const message_t *in, int64_t n, int64_t *taken)
{
    double values[VALUES];

    for (int64_t k = 0; k < n; k++) {
        const int64_t start = pace_now();
        int32_t error = say(bus, out, k, start);
        if (error) return error;
        do {
            if (!await(bus, in, values, NULL)) return ETIMEDOUT;
        } while ((int64_t)values[0] != k);
        taken[k] = pace_now() - start;
    }
    return 0;
}

/* Answers until *stop; how many it has answered. */
API int64_t tick_echo(bus_t *bus, const message_t *in, const message_t *out, const volatile int32_t *stop)
{
    double values[VALUES];
    int64_t n = 0;

    while (!*stop)
        if (await(bus, in, values, stop) && !say(bus, out, (int64_t)values[0], (int64_t)values[1])) n++;
    return n;
}

/* n ticks start_ns + k period_ns: takes what has come, says number k. `in`, `out`: may be NULL. Returns
 * how many samples came. */
API int64_t tick_run(bus_t *bus, const message_t *in, const message_t *out, int64_t start_ns,
                     int64_t period_ns, int64_t n, tick_t *ticks)
{
    double values[VALUES] = {-1, 0};
    int64_t came = 0, arrived = 0;

    for (int64_t k = 0; k < n; k++) {
        const int64_t woke = pace_wait(start_ns + k * period_ns, 0, NULL);
        while (in && heard(bus, in, values, &arrived)) came++;
        ticks[k] =
            (tick_t){woke - start_ns - k * period_ns, 0, (int64_t)values[0], (int64_t)values[1], arrived};
        if (out) {
            const int64_t before = pace_now();
            say(bus, out, k, before);
            ticks[k].paid = pace_now() - before;
        }
    }
    return came;
}

/* What has come, up to n: rows of number, sent, arrived (ns). Returns how many. */
API int64_t tick_take(bus_t *bus, const message_t *in, int64_t n, int64_t *rows)
{
    double values[VALUES];
    int64_t k = 0;

    while (k < n && heard(bus, in, values, &rows[3 * k + 2])) {
        rows[3 * k] = (int64_t)values[0];
        rows[3 * k + 1] = (int64_t)values[1];
        k++;
    }
    return k;
}
