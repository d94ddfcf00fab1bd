/* linux.c: see linux.h. */
#define _GNU_SOURCE
#include "linux.h"

#include <errno.h>
#include <linux/can.h>
#include <linux/can/raw.h>
#include <net/if.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <sys/timex.h>
#include <time.h>
#include <unistd.h>

/* ---- the clock of this host ---- */

static int64_t clock_ns(clockid_t which)
{
    struct timespec t;
    clock_gettime(which, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

int64_t linux_now_ns(void) { return clock_ns(CLOCK_MONOTONIC); }

static void set_date(participant_host_t *host)
{
    host->date_offset_ns = clock_ns(CLOCK_REALTIME) - clock_ns(CLOCK_MONOTONIC);
}

static uint32_t crc32_ieee(const char *text)
{
    uint32_t crc = 0xFFFFFFFFu;
    for (; *text; text++) {
        crc ^= (uint8_t)*text;
        for (int bit = 0; bit < 8; bit++) crc = crc >> 1 ^ (crc & 1 ? 0xEDB88320u : 0);
    }
    return ~crc;
}

static uint32_t turned(uint32_t x, int n) { return x >> n | x << (32 - n); }

/* The first 128 bits of SHA-256 (FIPS 180-4) of a text of at most 55 bytes: one block. */
static void sha256_128(const char *text, uint32_t digest[4])
{
    static const uint32_t K[64] = {
        0x428a2f98, 0x71374491, 0xb5c0fbcf, 0xe9b5dba5, 0x3956c25b, 0x59f111f1, 0x923f82a4, 0xab1c5ed5,
        0xd807aa98, 0x12835b01, 0x243185be, 0x550c7dc3, 0x72be5d74, 0x80deb1fe, 0x9bdc06a7, 0xc19bf174,
        0xe49b69c1, 0xefbe4786, 0x0fc19dc6, 0x240ca1cc, 0x2de92c6f, 0x4a7484aa, 0x5cb0a9dc, 0x76f988da,
        0x983e5152, 0xa831c66d, 0xb00327c8, 0xbf597fc7, 0xc6e00bf3, 0xd5a79147, 0x06ca6351, 0x14292967,
        0x27b70a85, 0x2e1b2138, 0x4d2c6dfc, 0x53380d13, 0x650a7354, 0x766a0abb, 0x81c2c92e, 0x92722c85,
        0xa2bfe8a1, 0xa81a664b, 0xc24b8b70, 0xc76c51a3, 0xd192e819, 0xd6990624, 0xf40e3585, 0x106aa070,
        0x19a4c116, 0x1e376c08, 0x2748774c, 0x34b0bcb5, 0x391c0cb3, 0x4ed8aa4a, 0x5b9cca4f, 0x682e6ff3,
        0x748f82ee, 0x78a5636f, 0x84c87814, 0x8cc70208, 0x90befffa, 0xa4506ceb, 0xbef9a3f7, 0xc67178f2};
    static const uint32_t H[8] = {0x6a09e667, 0xbb67ae85, 0x3c6ef372, 0xa54ff53a,
                                  0x510e527f, 0x9b05688c, 0x1f83d9ab, 0x5be0cd19};
    const size_t n = strlen(text);
    uint8_t block[64] = {0};
    uint32_t w[64], s[8];
    memcpy(block, text, n);
    block[n] = 0x80;
    block[62] = (uint8_t)(n >> 5);
    block[63] = (uint8_t)(n << 3);
    for (int i = 0; i < 16; i++)
        w[i] = (uint32_t)block[4 * i] << 24 | (uint32_t)block[4 * i + 1] << 16 |
               (uint32_t)block[4 * i + 2] << 8 | block[4 * i + 3];
    for (int i = 16; i < 64; i++)
        w[i] = w[i - 16] + (turned(w[i - 15], 7) ^ turned(w[i - 15], 18) ^ w[i - 15] >> 3) + w[i - 7] +
               (turned(w[i - 2], 17) ^ turned(w[i - 2], 19) ^ w[i - 2] >> 10);
    memcpy(s, H, sizeof s);
    for (int i = 0; i < 64; i++) {
        const uint32_t a = s[7] + (turned(s[4], 6) ^ turned(s[4], 11) ^ turned(s[4], 25)) +
                           ((s[4] & s[5]) ^ (~s[4] & s[6])) + K[i] + w[i];
        const uint32_t b = (turned(s[0], 2) ^ turned(s[0], 13) ^ turned(s[0], 22)) +
                           ((s[0] & s[1]) ^ (s[0] & s[2]) ^ (s[1] & s[2]));
        memmove(s + 1, s, 7 * sizeof *s);
        s[4] += a;
        s[0] = a + b;
    }
    for (int i = 0; i < 4; i++) digest[i] = s[i] + H[i];
}

static void describe_host(participant_host_t *host)
{
    FILE *file = fopen("/proc/sys/kernel/random/boot_id", "r");
    struct timex state;
    uint32_t digest[4];
    memset(host, 0, sizeof *host);
    if (!file || fscanf(file, "%47s", host->text) != 1) gethostname(host->text, 48);
    if (file) fclose(file);
    host->number = (int32_t)(crc32_ieee(host->text) % 255 + 1);
    sha256_128(host->text, digest);
    for (int i = 0; i < 4; i++) host->identity[i] = digest[i];
    memset(&state, 0, sizeof state);
    host->kept = adjtimex(&state) >= 0 && !(state.status & STA_UNSYNC);
    host->error = (double)state.maxerror * 1e-6;
    set_date(host);
}

/* ---- its life ---- */

static volatile sig_atomic_t stops;

static void on_signal(int number)
{
    (void)number;
    stops++;
}

void linux_begin(participant_t *p)
{
    describe_host(&p->host);
    p->boots = (uint32_t)(clock_ns(CLOCK_REALTIME) / 1000000000 % 4095) + 1; /* another one for each start */
    signal(SIGINT, on_signal);
    signal(SIGTERM, on_signal);
}

int64_t linux_poll(participant_t *p)
{
    static int obeyed;
    static int64_t dated;
    const int64_t now = linux_now_ns();
    if (now - dated > 1000000000) set_date(&p->host), dated = now;
    if (stops > obeyed) { /* once: ramp down; again, or before the start: at once */
        if (p->begun && obeyed == 0) participant_command(p, COMMAND_STOP);
        else participant_end(p);
        obeyed++;
    }
    return participant_poll(p, now);
}

int linux_end(const participant_t *p)
{
    const int finished = p->life.state == LIFE_FINISHED;
    fprintf(stderr, "%s: %s after %lld slots, reasons 0x%X\n", p->table->node,
            finished ? "finished" : "stopped", (long long)(p->slot - p->first_slot),
            (unsigned)p->life.reasons);
    return !finished;
}

/* ---- CAN buses ---- */

typedef struct {
    int in, out;          /* descriptors; of SocketCAN the same */
    int simulated;        /* 1: a bus that another process simulates */
    uint32_t token, sent; /* its number there; messages that were sent to it */
    size_t got;           /* bytes of its answer so far */
    uint8_t answer[16384];
} channel_t;

static int open_socketcan(const char *name)
{
    const int on = 1;
    struct ifreq interface;
    struct sockaddr_can address;
    const int fd = socket(PF_CAN, SOCK_RAW | SOCK_NONBLOCK, CAN_RAW);
    memset(&interface, 0, sizeof interface);
    memset(&address, 0, sizeof address);
    strncpy(interface.ifr_name, name, sizeof interface.ifr_name - 1);
    if (fd < 0 || ioctl(fd, SIOCGIFINDEX, &interface) < 0) return -1;
    address.can_family = AF_CAN;
    address.can_ifindex = interface.ifr_ifindex;
    setsockopt(fd, SOL_CAN_RAW, CAN_RAW_FD_FRAMES, &on, sizeof on);
    return bind(fd, (struct sockaddr *)&address, sizeof address) < 0 ? -1 : fd;
}

static void send_socketcan(int fd, const frame_t *frame)
{
    struct canfd_frame raw;
    memset(&raw, 0, sizeof raw);
    raw.can_id = frame->id | (frame->flags & FRAME_EXTENDED ? CAN_EFF_FLAG : 0);
    raw.len = (uint8_t)frame->length;
    raw.flags = frame->flags & FRAME_BRS ? CANFD_BRS : 0;
    memcpy(raw.data, frame->data, frame->length);
    if (write(fd, &raw, frame->flags & FRAME_FD ? CANFD_MTU : CAN_MTU) < 0)
        return; /* a full queue loses it */
}

static int receive_socketcan(int fd, frame_t *frame)
{
    struct canfd_frame raw;
    const ssize_t n = read(fd, &raw, sizeof raw);
    if (n != CAN_MTU && n != CANFD_MTU) return 0;
    memset(frame, 0, sizeof *frame);
    frame->id = raw.can_id & (raw.can_id & CAN_EFF_FLAG ? CAN_EFF_MASK : CAN_SFF_MASK);
    frame->flags =
        (uint8_t)((n == CANFD_MTU ? FRAME_FD : 0) | (raw.can_id & CAN_EFF_FLAG ? FRAME_EXTENDED : 0) |
                  (raw.can_id & CAN_RTR_FLAG ? FRAME_REMOTE : 0));
    frame->length = raw.len;
    memcpy(frame->data, raw.data, raw.len);
    return 1;
}

/* ---- a simulated bus: calls and answers as MessagePack, each behind its length (uint32, big endian) ---- */

typedef struct {
    uint8_t data[512];
    size_t n;
} call_t;

static void put(call_t *c, uint8_t byte) { c->data[c->n++] = byte; }

static void put_number(call_t *c, uint8_t kind, uint64_t value, int bytes)
{
    put(c, kind);
    while (bytes--) put(c, (uint8_t)(value >> 8 * bytes));
}

static void put_bytes(call_t *c, uint8_t kind, const void *data, size_t n) /* 0xD9: text, 0xC4: bytes */
{
    put_number(c, kind, n, 1);
    memcpy(c->data + c->n, data, n);
    c->n += n;
}

static void put_text(call_t *c, const char *text) { put_bytes(c, 0xD9, text, strlen(text)); }

static int send_call(int fd, const call_t *c)
{
    const uint8_t length[4] = {0, 0, (uint8_t)(c->n >> 8), (uint8_t)c->n};
    return send(fd, length, 4, MSG_NOSIGNAL | MSG_MORE) == 4 &&
           send(fd, c->data, c->n, MSG_NOSIGNAL) == (ssize_t)c->n;
}

/* A number in MessagePack (unsigned, or the bits of a float64, which are not needed), behind *at. */
static uint64_t read_number(const uint8_t **at)
{
    const uint8_t kind = *(*at)++;
    int bytes = kind == 0xCC ? 1 : kind == 0xCD ? 2 : kind == 0xCE ? 4 : kind == 0xCF || kind == 0xCB ? 8 : 0;
    uint64_t value = bytes ? 0 : kind;
    while (bytes--) value = value << 8 | *(*at)++;
    return value;
}

static size_t read_head(const uint8_t **at) /* entries of an array, bytes of a text or of bytes */
{
    const uint8_t kind = *(*at)++;
    if ((kind & 0xF0) == 0x90) return kind & 15;
    if ((kind & 0xE0) == 0xA0) return kind & 31;
    const int bytes = kind == 0xC4 || kind == 0xD9 ? 1 : kind == 0xDC || kind == 0xDA || kind == 0xC5 ? 2 : 0;
    size_t n = 0;
    for (int i = 0; i < bytes; i++) n = n << 8 | *(*at)++;
    return n;
}

/* Reads what has come; 1: a whole answer is there, -1: the connection has ended. */
static int gather(channel_t *c, int fd, int flags)
{
    size_t wanted = 4;
    if (c->got >= 4) wanted = 4 + ((size_t)c->answer[2] << 8 | c->answer[3]);
    while (c->got < wanted && wanted <= sizeof c->answer) {
        const ssize_t n = recv(fd, c->answer + c->got, wanted - c->got, flags);
        if (n <= 0) return n < 0 && (errno == EAGAIN || errno == EINTR) ? 0 : -1;
        c->got += (size_t)n;
        if (c->got >= 4) wanted = 4 + ((size_t)c->answer[2] << 8 | c->answer[3]);
    }
    return wanted <= sizeof c->answer ? 1 : -1;
}

/* The answer to a call, behind ["ok",; NULL: an error. */
static const uint8_t *answer_to(channel_t *c, int fd, const call_t *call)
{
    const uint8_t *at = c->answer + 4;
    c->got = 0;
    if (!send_call(fd, call) || gather(c, fd, 0) != 1) return 0;
    c->got = 0;
    read_head(&at);
    const size_t n = read_head(&at);
    return n == 2 && !memcmp(at, "ok", 2) ? at + 2 : 0;
}

static int connect_to(const char *host, const char *port)
{
    struct addrinfo hints, *found = 0;
    const int on = 1;
    memset(&hints, 0, sizeof hints);
    hints.ai_socktype = SOCK_STREAM;
    if (getaddrinfo(host, port, &hints, &found)) return -1;
    const int fd = socket(found->ai_family, SOCK_STREAM, 0);
    const int failed = fd < 0 || connect(fd, found->ai_addr, found->ai_addrlen);
    freeaddrinfo(found);
    if (failed) return -1;
    setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
    return fd;
}

/* Asks for up to 64 frames, waiting for the first one. */
static void ask(const channel_t *c)
{
    call_t call = {{0}, 0};
    put(&call, 0x95);
    put_text(&call, "receive");
    put_number(&call, 0xCE, c->token, 4);
    put(&call, 0);    /* after no message of ours */
    put(&call, 0xC0); /* as long as it takes */
    put(&call, 64);
    send_call(c->in, &call);
}

/* One connection keeps the bus open, one waits for frames, one sends. */
static int open_simulated(channel_t *c, const char *address)
{
    char name[128], *at, *port;
    strncpy(name, address, sizeof name - 1);
    name[sizeof name - 1] = 0;
    at = strrchr(name, '@');
    port = strrchr(name, ':');
    if (!at || !port || port < at) return -1;
    *at++ = *port++ = 0;
    const int keeps = connect_to(at, port);
    call_t call = {{0}, 0};
    put(&call, 0x94);
    put_text(&call, "open");
    put_text(&call, name);
    put(&call, 0x80);
    put(&call, 0x82);
    put_text(&call, "queue");
    put(&call, 0); /* fifo, as SocketCAN */
    put_text(&call, "tx_queue_size");
    put_number(&call, 0xCD, 1000, 2);
    const uint8_t *said = keeps < 0 ? 0 : answer_to(c, keeps, &call);
    if (!said) return -1;
    read_head(&said);
    const size_t server = read_head(&said);
    said += server; /* its name */
    c->token = (uint32_t)read_number(&said);
    for (int i = 0; i < 2; i++) {
        const int fd = connect_to(at, port);
        char thread[64];
        snprintf(thread, sizeof thread, "participant %d %d", (int)getpid(), i);
        call.n = 0;
        put(&call, 0x92);
        put_text(&call, "join");
        put_text(&call, thread);
        if (fd < 0 || !answer_to(c, fd, &call)) return -1;
        *(i ? &c->out : &c->in) = fd;
    }
    ask(c);
    return 0;
}

static void send_simulated(channel_t *c, const frame_t *frame)
{
    channel_t of_call;
    call_t call = {{0}, 0};
    put(&call, 0x95);
    put_text(&call, "send");
    put_number(&call, 0xCE, c->token, 4);
    put_number(&call, 0xCE, c->sent++, 4); /* behind so many */
    put(&call, 0x95);
    put_number(&call, 0xCE, frame->id, 4);
    put(&call, (uint8_t)((frame->flags & FRAME_EXTENDED ? 1 : 0) | (frame->flags & FRAME_FD ? 8 : 0) |
                         (frame->flags & FRAME_BRS ? 16 : 0)));
    put(&call, (uint8_t)frame->length);
    put_bytes(&call, 0xC4, frame->data, frame->length);
    put(&call, 0);
    put(&call, 0xC0);
    of_call.got = 0;
    answer_to(&of_call, c->out, &call);
}

/* Hands over the frames of an answer that is complete; -1: the bus has ended. */
static int receive_simulated(channel_t *c, participant_t *p, int32_t bus)
{
    const uint8_t *at = c->answer + 4;
    const int found = gather(c, c->in, MSG_DONTWAIT);
    if (found <= 0) return found;
    read_head(&at);
    const size_t word = read_head(&at);
    if (word != 2) return -1;
    at += word;
    for (size_t n = read_head(&at); n > 0; n--) {
        frame_t frame;
        memset(&frame, 0, sizeof frame);
        read_head(&at);
        frame.id = (uint32_t)read_number(&at);
        const uint64_t flags = read_number(&at);
        read_number(&at);
        frame.length = (uint16_t)read_head(&at);
        memcpy(frame.data, at, frame.length);
        at += frame.length;
        read_number(&at);
        frame.flags = (uint8_t)((flags & 1 ? FRAME_EXTENDED : 0) | (flags & 2 ? FRAME_REMOTE : 0) |
                                (flags & 4 ? FRAME_ERROR : 0) | (flags & 8 ? FRAME_FD : 0));
        frame.bus = (uint8_t)bus;
        frame.t_ns = linux_now_ns();
        if (!(flags & 4)) participant_hear(p, &frame);
    }
    c->got = 0;
    ask(c);
    return 0;
}

/* ---- the loop ---- */

typedef struct {
    channel_t *channels;
    participant_step_t step;
    void *context;
} loop_t;

static void send_on(void *context, int32_t bus, const frame_t *frame, const char *key)
{
    channel_t *c = ((loop_t *)context)->channels + bus;
    (void)key;
    if (c->simulated) send_simulated(c, frame);
    else send_socketcan(c->out, frame);
}

static void step_of(void *context, participant_t *p, double t, double h)
{
    const loop_t *loop = context;
    loop->step(loop->context, p, t, h);
}

static int open_channel(channel_t *c, const char *channel)
{
    memset(c, 0, sizeof *c);
    c->simulated = strchr(channel, '@') != 0;
    if (c->simulated) return open_simulated(c, channel);
    c->in = c->out = open_socketcan(channel);
    return c->in < 0 ? -1 : 0;
}

static int open_all(const participant_table_t *t, channel_t *channels, int argc, char **argv)
{
    for (int32_t b = 0; b < t->n_buses; b++) {
        const char *channel = b + 1 < argc && !strchr(argv[b + 1], '=') ? argv[b + 1] : 0;
        const size_t n = strlen(t->buses[b].name);
        for (int i = 1; i < argc; i++)
            if (!strncmp(argv[i], t->buses[b].name, n) && argv[i][n] == '=') channel = argv[i] + n + 1;
        if (!channel) {
            fprintf(stderr, "error: found no channel for bus %s, expected %s CHANNEL or %s=CHANNEL\n",
                    t->buses[b].name, argv[0], t->buses[b].name);
            return 2;
        }
        if (open_channel(channels + b, channel)) {
            fprintf(stderr,
                    "error: bus %s: %s cannot be opened (%s), expected a SocketCAN interface or "
                    "NAME@HOST:PORT of a simulated bus\n",
                    t->buses[b].name, channel, strerror(errno));
            return 2;
        }
    }
    return 0;
}

/* Waits until a frame or the deadline comes, and hands over what has come; -1: a bus has ended. */
static int rest(participant_t *p, channel_t *channels, int64_t until_ns)
{
    struct pollfd fds[PARTICIPANT_BUSES];
    const int32_t n = p->table->n_buses;
    const int64_t left = until_ns - linux_now_ns();
    const struct timespec wait = {left > 0 ? left / 1000000000 : 0, left > 0 ? left % 1000000000 : 0};
    frame_t frame;
    for (int32_t b = 0; b < n; b++) fds[b] = (struct pollfd){channels[b].in, POLLIN, 0};
    if (ppoll(fds, (nfds_t)n, &wait, 0) <= 0) return 0;
    for (int32_t b = 0; b < n; b++) {
        if (!fds[b].revents) continue;
        if (channels[b].simulated && receive_simulated(channels + b, p, b) < 0) return -1;
        while (!channels[b].simulated && receive_socketcan(channels[b].in, &frame)) {
            frame.bus = (uint8_t)b;
            frame.t_ns = linux_now_ns();
            participant_hear(p, &frame);
        }
    }
    return 0;
}

int run_on_can(int argc, char **argv, const participant_table_t *table, participant_step_t step,
               void *context)
{
    static channel_t channels[PARTICIPANT_BUSES];
    static participant_t p;
    loop_t loop = {channels, step, context};
    const int failed = open_all(table, channels, argc, argv);
    if (failed) return failed;
    participant_init(&p, table, send_on, step_of, &loop);
    linux_begin(&p);
    for (int64_t next = linux_now_ns(); next >= 0; next = linux_poll(&p)) {
        if (rest(&p, channels, next) < 0) {
            fprintf(stderr, "error: a bus has ended\n");
            return 1;
        }
    }
    return linux_end(&p);
}
