/* zenoh_pico.c: see zenoh_pico.h.
 *
 * zenoh-pico's thread writes each sample into a pipe, so that the loop is the only thread that calls the
 * participant; queries are answered under a lock.
 */
#define _GNU_SOURCE
#include "zenoh_pico.h"

#include <poll.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>
#include <zenoh-pico.h>

#include "linux.h"

enum { SUBSCRIPTIONS = PARTICIPANT_INPUTS + PARTICIPANT_PEERS + 3, KEYS = PARTICIPANT_OUTPUTS + 3 };
static const char *const QUERIES[] = {"state", "parameters", "clock", "arm", "stop"};
static const char *const TOKENS[] = {"alive", "ready"};

typedef struct {
    int32_t bus;
    uint32_t id;
} heard_t;

static struct {
    participant_t p;
    participant_step_t step;
    void *context;
    pthread_mutex_t lock;
    int pipe[2];
    z_owned_session_t session;
    heard_t heard[SUBSCRIPTIONS];
    const char *keys[KEYS];
    z_owned_publisher_t publishers[KEYS];
    int32_t n_keys;
    z_owned_liveliness_token_t tokens[2];
} node = {.lock = PTHREAD_MUTEX_INITIALIZER};

/* ---- what comes ---- */

static void on_sample(z_loaned_sample_t *sample, void *context)
{
    const heard_t *of = context;
    const z_loaned_bytes_t *payload = z_sample_payload(sample);
    z_bytes_reader_t reader = z_bytes_get_reader(payload);
    frame_t frame;
    memset(&frame, 0, sizeof frame);
    frame.t_ns = linux_now_ns();
    frame.bus = (uint8_t)of->bus;
    frame.id = of->id;
    if (z_bytes_len(payload) > sizeof frame.data) return; /* longer than any message */
    frame.length = (uint16_t)z_bytes_reader_read(&reader, frame.data, sizeof frame.data);
    if (write(node.pipe[1], &frame, sizeof frame) < 0) return;
}

static void on_query(z_loaned_query_t *query, void *context)
{
    const char *what = context;
    char text[4096];
    z_owned_bytes_t payload;
    pthread_mutex_lock(&node.lock);
    participant_answer(&node.p, what, text, sizeof text);
    if (!strcmp(what, "arm")) participant_command(&node.p, COMMAND_ARM);
    if (!strcmp(what, "stop")) participant_command(&node.p, COMMAND_STOP);
    pthread_mutex_unlock(&node.lock);
    z_bytes_copy_from_str(&payload, text);
    z_query_reply(query, z_query_keyexpr(query), z_move(payload), NULL);
}

/* ---- what goes ---- */

static void send_on(void *context, int32_t bus, const frame_t *frame, const char *key)
{
    (void)context, (void)bus;
    for (int32_t i = 0; key && i < node.n_keys; i++) {
        z_owned_bytes_t payload;
        if (strcmp(node.keys[i], key)) continue;
        z_bytes_copy_from_buf(&payload, frame->data, frame->length);
        z_publisher_put(z_loan(node.publishers[i]), z_move(payload), NULL);
    }
}

static void step_of(void *context, participant_t *p, double t, double h)
{
    (void)context;
    node.step(node.context, p, t, h);
}

/* ---- the session ---- */

static int publish(const char *key)
{
    z_view_keyexpr_t expression;
    z_publisher_options_t options;
    if (!key) return 0;
    z_publisher_options_default(&options);
    options.priority = Z_PRIORITY_REAL_TIME;
    options.congestion_control = Z_CONGESTION_CONTROL_DROP;
    options.is_express = true;
    node.keys[node.n_keys] = key;
    z_view_keyexpr_from_str_unchecked(&expression, key);
    return z_declare_publisher(z_loan(node.session), &node.publishers[node.n_keys++], z_loan(expression),
                               &options);
}

static int publish_all(const participant_table_t *t)
{
    const bus_table_t *bus = t->buses;
    int failed = publish(bus->heartbeat_key) | publish(bus->estop_key) | publish(bus->epoch_key);
    for (int32_t i = 0; i < t->n_sent; i++) failed |= publish(t->sent[i].key);
    return failed;
}

static int subscribe_all(void)
{
    const char *key;
    int failed = 0;
    for (int32_t i = 0; (key = participant_subscription(&node.p, i, &node.heard[i].bus, &node.heard[i].id));
         i++) {
        z_owned_closure_sample_t callback;
        z_view_keyexpr_t expression;
        if (!*key) continue;
        z_view_keyexpr_from_str_unchecked(&expression, key);
        z_closure(&callback, on_sample, NULL, &node.heard[i]);
        failed |=
            z_declare_background_subscriber(z_loan(node.session), z_loan(expression), z_move(callback), NULL);
    }
    return failed;
}

static void name_of(char *key, size_t size, const char *what)
{
    snprintf(key, size, "%s/%s/%s", node.p.table->buses->prefix, node.p.table->node, what);
}

static int answer_all(void)
{
    int failed = 0;
    for (size_t i = 0; i < sizeof QUERIES / sizeof *QUERIES; i++) {
        z_owned_closure_query_t callback;
        z_view_keyexpr_t expression;
        char key[256];
        name_of(key, sizeof key, QUERIES[i]);
        z_view_keyexpr_from_str_unchecked(&expression, key);
        z_closure(&callback, on_query, NULL, (void *)QUERIES[i]);
        failed |=
            z_declare_background_queryable(z_loan(node.session), z_loan(expression), z_move(callback), NULL);
    }
    return failed;
}

static int token(int which)
{
    z_view_keyexpr_t expression;
    char key[256];
    name_of(key, sizeof key, TOKENS[which]);
    z_view_keyexpr_from_str_unchecked(&expression, key);
    return z_liveliness_declare_token(z_loan(node.session), &node.tokens[which], z_loan(expression), NULL);
}

/* A client of the other end, or a peer that others connect to. */
static int open_session(int argc, char **argv)
{
    const char *listen = argc > 1 ? argv[1] : "", *connect = argc > 2 ? argv[2] : "";
    for (int tries = 0; tries < 100; tries++) { /* the other end may not listen yet */
        z_owned_config_t config;
        z_config_default(&config);
        zp_config_insert(z_loan_mut(config), Z_CONFIG_MODE_KEY, *connect ? "client" : "peer");
        zp_config_insert(z_loan_mut(config), *connect ? Z_CONFIG_CONNECT_KEY : Z_CONFIG_LISTEN_KEY,
                         *connect ? connect : listen);
        if (z_open(&node.session, z_move(config), NULL) == 0) {
            zp_start_read_task(z_loan_mut(node.session), NULL);
            zp_start_lease_task(z_loan_mut(node.session), NULL);
            return 0;
        }
        nanosleep(&(struct timespec){0, 200000000}, NULL);
    }
    return -1;
}

static void rest(int64_t until_ns)
{
    struct pollfd fd = {node.pipe[0], POLLIN, 0};
    const int64_t left = until_ns - linux_now_ns();
    const struct timespec wait = {left > 0 ? left / 1000000000 : 0, left > 0 ? left % 1000000000 : 0};
    frame_t frame;
    while (ppoll(&fd, 1, &wait, 0) > 0 && read(node.pipe[0], &frame, sizeof frame) == sizeof frame) {
        pthread_mutex_lock(&node.lock);
        participant_hear(&node.p, &frame);
        pthread_mutex_unlock(&node.lock);
        if (linux_now_ns() >= until_ns) break;
    }
}

int run_on_zenoh(int argc, char **argv, const participant_table_t *table, participant_step_t step,
                 void *context)
{
    int64_t next = linux_now_ns();
    int ready = 0;
    node.step = step;
    node.context = context;
    participant_init(&node.p, table, send_on, step_of, &node);
    if (pipe(node.pipe) || open_session(argc, argv) || publish_all(table) || subscribe_all() ||
        answer_all() || token(0)) {
        fprintf(stderr, "error: no Zenoh session; expected %s LISTEN CONNECT, endpoints or \"\"\n", argv[0]);
        return 2;
    }
    linux_begin(&node.p);
    while (next >= 0) {
        rest(next);
        pthread_mutex_lock(&node.lock);
        next = linux_poll(&node.p);
        const int may = participant_ready(&node.p);
        pthread_mutex_unlock(&node.lock);
        if (!ready && may) ready = !token(1);
    }
    nanosleep(&(struct timespec){0, 100000000}, NULL); /* the last samples leave */
    z_drop(z_move(node.session));
    return linux_end(&node.p);
}
