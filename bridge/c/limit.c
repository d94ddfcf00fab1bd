/* limit.c: see limit.h */
#include "limit.h"

int32_t limits_range(const limit_t *limits, int32_t n, const double *values)
{
    for (int32_t i = 0; limits && i < n; i++)
        if (!(values[i] >= limits[i].low && values[i] <= limits[i].high)) return 0;
    return 1;
}

int32_t limits_rate(const limit_t *limits, int32_t n, const double *values, const double *last,
                    double seconds)
{
    for (int32_t i = 0; limits && i < n; i++) {
        const double step = limits[i].rate * seconds;
        double low = last[i], high = last[i];
        if (limits[i].falls && low > 0.0) low = 0.0;
        if (limits[i].falls && high < 0.0) high = 0.0;
        if (!(values[i] >= low - step && values[i] <= high + step)) return 0;
    }
    return 1;
}
