/* pace.c: see pace.h */
#define _GNU_SOURCE
#include "pace.h"

#include <math.h>

#if defined(_WIN32)
#include <windows.h>
#else
#include <time.h>

static int64_t real_now(void)
{
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    return (int64_t)now.tv_sec * 1000000000 + now.tv_nsec;
}
#endif

enum { LINEAR = 1024, PER_OCTAVE = 64, STEP_US = LINEAR / PER_OCTAVE };

static const int64_t SECOND = 1000000000;

/* ---- histogram ---- */

static int32_t bin_of(int64_t ns)
{
    int64_t us = ns / 1000;
    int32_t octave = 0;
    if (ns < 0) return 0;
    if (us < LINEAR) return (int32_t)us;
    while (us >= 2 * LINEAR) {
        us /= 2;
        octave++;
    }
    int64_t bin = LINEAR + (int64_t)octave * PER_OCTAVE + (us - LINEAR) / STEP_US;
    return bin < PACE_BINS ? (int32_t)bin : PACE_BINS - 1;
}

static double upper_edge(int32_t bin)
{
    if (bin < LINEAR) return 1e3 * (bin + 1);
    int32_t octave = (bin - LINEAR) / PER_OCTAVE, step = (bin - LINEAR) % PER_OCTAVE;
    return 1e3 * (double)((int64_t)(LINEAR + (step + 1) * STEP_US) << octave);
}

void histogram_add(histogram_t *h, int64_t ns)
{
    if (h->count == 0 || ns < h->minimum) h->minimum = ns;
    if (h->count == 0 || ns > h->maximum) h->maximum = ns;
    h->count++;
    h->sum += (double)ns;
    h->bins[bin_of(ns)]++;
}

double histogram_quantile(const histogram_t *h, double q)
{
    int64_t rank = (int64_t)ceil(q * (double)h->count), below = 0;
    int32_t bin = 0;
    if (h->count == 0) return NAN;
    if (rank < 1) rank = 1;
    if (rank > h->count) rank = h->count;
    while (bin < PACE_BINS - 1 && (below += h->bins[bin]) < rank) bin++;
    double edge = upper_edge(bin), most = (double)h->maximum;
    return edge < most && bin < PACE_BINS - 1 ? edge : most;
}

/* ---- clock and sleep, a system each ---- */

static int64_t real_now(void);

/* The narrowest of three readings: a switch of threads between two clocks is not taken for time. */
int64_t pace_date(void)
{
    int64_t narrowest = INT64_MAX, date = 0;
    for (int32_t i = 0; i < 3; i++) {
        const int64_t before = pace_now(), real = real_now(), after = pace_now();
        if (after - before < narrowest) {
            narrowest = after - before;
            date = real - before - narrowest / 2;
        }
    }
    return date;
}

#if defined(_WIN32)

int64_t pace_now(void)
{
    LARGE_INTEGER count, frequency;
    QueryPerformanceCounter(&count);
    QueryPerformanceFrequency(&frequency);
    return count.QuadPart / frequency.QuadPart * SECOND +
           count.QuadPart % frequency.QuadPart * SECOND / frequency.QuadPart;
}

static int64_t real_now(void) /* FILETIME: 100 ns since 1601 */
{
    FILETIME found;
    GetSystemTimePreciseAsFileTime(&found);
    const int64_t ticks = (int64_t)found.dwHighDateTime << 32 | found.dwLowDateTime;
    return (ticks - 116444736000000000) * 100;
}

/* Sleeps in ms, and gives up its turn for what is left. */
static void sleep_towards(int64_t deadline_ns)
{
    int64_t left = deadline_ns - pace_now();
    if (left > 2000000) Sleep((DWORD)(left / 1000000 < 1000 ? left / 1000000 - 1 : 1000));
    else SwitchToThread();
}

#elif defined(__linux__)

int64_t pace_now(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec * SECOND + now.tv_nsec;
}

static void sleep_towards(int64_t deadline_ns)
{
    struct timespec until = {.tv_sec = deadline_ns / SECOND, .tv_nsec = deadline_ns % SECOND};
    clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL);
}

#else

int64_t pace_now(void)
{
    struct timespec now;
#if defined(__APPLE__)
    clock_gettime(CLOCK_UPTIME_RAW, &now);
#else
    clock_gettime(CLOCK_MONOTONIC, &now);
#endif
    return now.tv_sec * SECOND + now.tv_nsec;
}

static void sleep_towards(int64_t deadline_ns)
{
    int64_t left = deadline_ns - pace_now();
    if (left > 0) {
        struct timespec rest = {.tv_sec = left / SECOND, .tv_nsec = left % SECOND};
        nanosleep(&rest, NULL);
    }
}

#endif

static inline void cpu_relax(void) /* tells the processor that this is a spin loop */
{
#if defined(__x86_64__) || defined(__i386__)
    __builtin_ia32_pause();
#elif defined(__aarch64__)
    __asm__ __volatile__("yield");
#endif
}

int64_t pace_wait(int64_t deadline_ns, int64_t spin_ns, const volatile int32_t *stop)
{
    int64_t now = INT64_MIN, asleep = deadline_ns - (spin_ns > 0 ? spin_ns : 0);
    while (now < asleep && !(stop && *stop)) { /* no sleep if the deadline has passed */
        sleep_towards(asleep);
        now = pace_now();
    }
    if (now == INT64_MIN) now = pace_now();
    while (now < deadline_ns && !(stop && *stop)) {
        cpu_relax();
        now = pace_now();
    }
    return now;
}

int64_t pace_run(int64_t start_ns, int64_t period_ns, int64_t n, int64_t spin_ns,
                 const volatile int32_t *stop, int64_t *woke)
{
    int64_t k;
    for (k = 0; k < n && !(stop && *stop); k++) woke[k] = pace_wait(start_ns + k * period_ns, spin_ns, stop);
    return k > 0 && stop && *stop ? k - 1 : k;
}
