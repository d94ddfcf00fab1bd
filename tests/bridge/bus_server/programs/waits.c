/* waits.c: each line is a call that waits, and how long it took by CLOCK_MONOTONIC, us. */
#define _GNU_SOURCE
#include <errno.h>
#include <linux/futex.h>
#include <poll.h>
#include <pthread.h>
#include <semaphore.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/epoll.h>
#include <sys/select.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <sys/timerfd.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

static pthread_mutex_t mutex = PTHREAD_MUTEX_INITIALIZER;
static pthread_cond_t changed = PTHREAD_COND_INITIALIZER;
static sem_t semaphore;
static int ends[2];
static uint32_t word;

static int64_t now(clockid_t clock)
{
    struct timespec t;

    clock_gettime(clock, &t);
    return (int64_t)t.tv_sec * 1000000 + t.tv_nsec / 1000;
}

static struct timespec in_us(clockid_t clock, int64_t us)
{
    const int64_t when = (clock < 0 ? 0 : now(clock)) + us;
    const struct timespec t = {when / 1000000, when % 1000000 * 1000};

    return t;
}

static void said(const char *what, int64_t since, int result)
{
    printf("%s %d %lld\n", what, result, (long long)(now(CLOCK_MONOTONIC) - since));
}

#define SAY(what, call)                             \
    {                                               \
        const int64_t since = now(CLOCK_MONOTONIC); \
        const int result = (int)(call);             \
        said(what, since, result);                  \
    }

static void *other(void *given)
{
    (void)given;
    usleep(4000);
    pthread_mutex_lock(&mutex);
    pthread_cond_signal(&changed);
    pthread_mutex_unlock(&mutex);
    usleep(4000);
    sem_post(&semaphore);
    usleep(4000);
    if (write(ends[1], "x", 1) < 0) abort();
    usleep(4000);
    __atomic_store_n(&word, 1, __ATOMIC_SEQ_CST);
    syscall(SYS_futex, &word, FUTEX_WAKE, 1, NULL, NULL, 0);
    return NULL;
}

static int in_other_process(void)
{
    int status;
    const pid_t child = fork();

    if (child == 0) {
        usleep(2500);
        _exit(7);
    }
    waitpid(child, &status, 0);
    return WEXITSTATUS(status);
}

static void on_alarm(int number) { (void)number; }

int main(void)
{
    struct pollfd file = {-1, POLLIN, 0};
    struct timeval short_time = {0, 2500};
    struct itimerval soon = {{0, 0}, {0, 1500}};
    const struct itimerspec period = {{0, 2000000}, {0, 500000}};
    const int timer = timerfd_create(CLOCK_MONOTONIC, TFD_CLOEXEC);
    uint64_t expired;
    struct sigaction action = {.sa_handler = on_alarm};
    struct timespec t;
    struct timeval date;
    struct epoll_event event;
    pthread_t thread;
    fd_set files;
    char byte;
    const int epoll = epoll_create1(0);

    if (pipe(ends) < 0) return 1;
    sem_init(&semaphore, 0, 0);
    gettimeofday(&date, NULL);
    printf("dates %lld %lld %lld %lld %lld\n", (long long)now(CLOCK_REALTIME), (long long)time(NULL),
           (long long)date.tv_sec, (long long)now(CLOCK_MONOTONIC), (long long)now(CLOCK_BOOTTIME));
    t = in_us(-1, 1500);
    SAY("nanosleep", nanosleep(&t, NULL))
    t = in_us(CLOCK_REALTIME, 1500);
    SAY("clock_nanosleep", clock_nanosleep(CLOCK_REALTIME, TIMER_ABSTIME, &t, NULL))
    SAY("sleep", sleep(2))
    SAY("poll", poll(&file, 1, 7))
    t = in_us(-1, 250);
    SAY("ppoll", ppoll(&file, 1, &t, NULL))
    FD_ZERO(&files);
    FD_SET(ends[0], &files);
    SAY("select", select(ends[0] + 1, &files, NULL, NULL, &short_time))
    printf("left %d of %ld us\n", FD_ISSET(ends[0], &files), (long)short_time.tv_usec);
    t = in_us(-1, 3500);
    SAY("pselect", pselect(0, NULL, NULL, NULL, &t, NULL))
    SAY("epoll_wait", epoll_wait(epoll, &event, 1, 4))
    pthread_mutex_lock(&mutex);
    t = in_us(CLOCK_REALTIME, 5000);
    SAY("pthread_cond_timedwait", pthread_cond_timedwait(&changed, &mutex, &t) == ETIMEDOUT)
    t = in_us(CLOCK_REALTIME, 6000);
    SAY("sem_timedwait", sem_timedwait(&semaphore, &t))
    t = in_us(-1, 700);
    SAY("futex", syscall(SYS_futex, &word, FUTEX_WAIT, 0, &t, NULL, 0))
    pthread_create(&thread, NULL, other, NULL);
    t = in_us(CLOCK_REALTIME, 50000);
    SAY("signalled", pthread_cond_timedwait(&changed, &mutex, &t))
    pthread_mutex_unlock(&mutex);
    SAY("posted", sem_wait(&semaphore))
    SAY("written", read(ends[0], &byte, 1))
    t = in_us(-1, 50000);
    SAY("woken", syscall(SYS_futex, &word, FUTEX_WAIT, 0, &t, NULL, 0))
    SAY("joined", pthread_join(thread, NULL))
    SAY("forked", in_other_process())
    SAY("shelled", system("sleep 0.0025; exit 3") >> 8)
    sigaction(SIGALRM, &action, NULL);
    setitimer(ITIMER_REAL, &soon, NULL);
    SAY("alarmed", usleep(10000))
    timerfd_settime(timer, 0, &period, NULL);
    event.events = EPOLLIN;
    epoll_ctl(epoll, EPOLL_CTL_ADD, timer, &event);
    SAY("first", epoll_wait(epoll, &event, 1, 1000))
    usleep(7000);
    SAY("expired", read(timer, &expired, sizeof expired) == 8 ? expired : 0)
    SAY("next", read(timer, &expired, sizeof expired) == 8 ? expired : 0)
    {
        const int64_t since = now(CLOCK_MONOTONIC);

        while (now(CLOCK_MONOTONIC) < since + 3000) {}
        said("spun", since, 0);
    }
    return 0;
}
