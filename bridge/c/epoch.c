/* epoch.c: the values of EPOCH; see epoch.h. */
#include "epoch.h"

#include "pace.h"

enum { UNIT_NS = 10000 };
static const int64_t TURN_NS = ((int64_t)1 << 33) * UNIT_NS;
static const int64_t AHEAD_NS = 300000000000; /* the latest origin, from now */

int64_t epoch_origin_ns(double us, int64_t arrival_ns)
{
    int64_t since = (arrival_ns + pace_date() - (int64_t)us * 1000) % TURN_NS;
    if (since < 0) since += TURN_NS;
    if (since > TURN_NS - AHEAD_NS) since -= TURN_NS;
    return arrival_ns - since;
}

API int64_t epoch_origin_us(int64_t date_ns) { return (date_ns + UNIT_NS / 2) % TURN_NS / UNIT_NS * 10; }

API int32_t epoch_run(int64_t origin_ns) { return (int32_t)(origin_ns / 1000 % EPOCH_RUNS) + 1; }

void epoch_host_values(const double *epoch, double *values)
{
    for (int32_t i = 0; i < EPOCH_VALUES; i++) values[i] = 0.0;
    values[EPOCH_RUN] = (int32_t)epoch[EPOCH_HOST] & EPOCH_DATE_RUN;
    values[EPOCH_HOST] = EPOCH_DATE_HOST;
    values[EPOCH_KEPT] = 1.0;
    values[EPOCH_ORIGIN] = epoch[EPOCH_IDENTITY] * 10.0;
}

int32_t epoch_host_is(const epoch_t *e, const double *values)
{
    if (e->identity[0] == 0.0) return 0;
    return values[EPOCH_ORIGIN] == e->identity[0] * 10.0 ? 1 : -1;
}
