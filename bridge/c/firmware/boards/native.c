/* native.c - a process as a board: its serial line is standard input and output. */
#define _POSIX_C_SOURCE 200809L
#include <poll.h>
#include <stdlib.h>
#include <time.h>
#include <unistd.h>

#include "board.h"

static int32_t comes(int32_t ms)
{
    struct pollfd line = {0, POLLIN, 0};
    return poll(&line, 1, ms) > 0;
}

int32_t board_read(uint8_t *to, int32_t n)
{
    if (n <= 0 || !comes(0)) return 0;
    const ssize_t found = read(0, to, (size_t)n);
    if (found <= 0) exit(0); /* the host has closed the other end */
    return (int32_t)found;
}

void board_write(const uint8_t *from, int32_t n)
{
    while (n > 0) {
        const ssize_t done = write(1, from, (size_t)n);
        if (done <= 0) exit(0);
        from += done, n -= (int32_t)done;
    }
}

int64_t board_time_ns(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000000000 + now.tv_nsec;
}

void board_sleep(int64_t until_ns)
{
    struct pollfd line = {0, POLLIN, 0};
    const int64_t left = until_ns - board_time_ns();
    const struct timespec rest = {.tv_nsec = 200000};
    if (left >= 2000000) poll(&line, 1, (int)(left / 1000000) - 1);
    else if (left > 200000) nanosleep(&rest, NULL);
}

uint32_t board_stack(void) { return 0; }
void board_end(void) {}
