/* records.c - the HAL of the examples (hal.h): CAN frames as records on a serial line; and their program.
 *
 * A record is 0xC5, a type, the length of its payload (2 bytes), the payload and a CRC-16 (polynomial 0x1021,
 * start 0xFFFF) of type, length and payload; numbers are little endian. What is none is skipped to the next
 * 0xC5, and counted. To the image:
 *
 *   m  mode: 0 wall, 1 slots (1 byte); it may be followed by the number of lives before this one (4)
 *   f  a frame: bus, flags (frame.h), length, 0 (a byte each); id (4); t_ns (8); data
 *   s  the next slot: its number, limit_ns (8 each)
 *   t  a command (1 byte, COMMAND_...)
 *   q  the end of the program
 *
 * From the image:
 *
 *   h  version 1, number of the node (2 each), bytes of a row of the journal (4); h_ns, phase_ns, slots (8 each);
 *      token (16); name of the node
 *   f  a frame that it sends
 *   j  a row of the journal of received samples (sample_journal.h)
 *   r  a row of the journal (rows.h)
 *   d  a slot is done: its number (8), result, rows j that did not fit (4 each)
 *   l  a line for people
 *
 * A slot is answered by f*, j*, r, d in this order.
 */
#include <string.h>

#include "board.h"
#include "crc.h"
#include "firmware.h"
#include "hal.h"
#include "run_epoch.h"
#include "slot.h"

enum { MAGIC = 0xC5, HEAD = 4, FRAME_HEAD = 16, LONGEST = FRAME_HEAD + FRAME_DATA, VERSION = 1 };
enum { INPUT = 4 * LONGEST, QUEUE = 32 /* frames of a bus between two looks, a power of two */ };
enum { MODE_NONE = -1, MODE_WALL, MODE_SLOTS };

typedef struct {
    uint32_t head, tail;
    frame_t frames[QUEUE];
} queue_t;

/* A journal in memory, with room for so many bytes of rows. */
#define JOURNAL(bytes)       \
    struct {                 \
        journal_t head;      \
        uint8_t rows[bytes]; \
    }

static queue_t received[N_BUSES];
static JOURNAL(ROW_SIZE) row;
static JOURNAL(HEARD_ROWS *HEARD_SIZE) heard;
static uint8_t input[INPUT];
static int32_t n_input;
static uint32_t skipped, lost; /* bytes that belong to no record; frames without room */
static int32_t mode = MODE_NONE, asked = MODE_NONE, ended;

/* --- records out ---------------------------------------------------------------------------------- */

static uint8_t *put(uint8_t *to, uint64_t value, int32_t bytes)
{
    for (int32_t i = 0; i < bytes; i++) *to++ = (uint8_t)(value >> 8 * i);
    return to;
}

static void write(char type, const void *a, int32_t n_a, const void *b, int32_t n_b)
{
    uint8_t head[HEAD] = {MAGIC, (uint8_t)type}, end[2];
    put(head + 2, (uint64_t)(n_a + n_b), 2);
    uint16_t crc = crc16_ccitt(0xFFFF, head + 1, HEAD - 1);
    crc = crc16_ccitt(crc16_ccitt(crc, a, n_a), b, n_b);
    put(end, crc, 2);
    board_write(head, HEAD);
    board_write(a, n_a);
    board_write(b, n_b);
    board_write(end, 2);
}

static void hello(void)
{
    static const uint8_t token[16] = TOKEN_BYTES;
    const node_t *n = firmware_node();
    uint8_t head[2 + 2 + 4 + 3 * 8 + sizeof token], *to = head;
    to = put(put(put(to, VERSION, 2), (uint64_t)n->number, 2), ROW_SIZE, 4);
    to = put(put(put(to, (uint64_t)n->h_ns, 8), (uint64_t)n->phase_ns, 8), (uint64_t)n->slots, 8);
    memcpy(to, token, sizeof token);
    write('h', head, sizeof head, NODE_NAME, sizeof NODE_NAME - 1);
}

static char *number(char *to, uint32_t value)
{
    if (value >= 10) to = number(to, value / 10);
    *to = (char)('0' + value % 10);
    return to + 1;
}

static void say(const char *text, uint32_t value)
{
    char line[80], *to = line;
    while (*text && to < line + 64) *to++ = *text++;
    to = number(to, value);
    write('l', line, (int32_t)(to - line), 0, 0);
}

/* --- records in ----------------------------------------------------------------------------------- */

static uint64_t get(const uint8_t *from, int32_t bytes)
{
    uint64_t value = 0;
    for (int32_t i = bytes; i--;) value = value << 8 | from[i];
    return value;
}

static void take_frame(const uint8_t *p, int32_t n)
{
    const uint32_t bus = p[0], length = p[2];
    if (n < FRAME_HEAD || bus >= N_BUSES || length > FRAME_DATA || n != FRAME_HEAD + (int32_t)length) return;
    queue_t *q = received + bus;
    if (q->head - q->tail == QUEUE) {
        lost++;
        return;
    }
    frame_t *f = q->frames + (q->head++ & (QUEUE - 1));
    memset(f, 0, sizeof *f);
    f->bus = (uint8_t)bus, f->flags = p[1], f->length = (uint16_t)length, f->id = (uint32_t)get(p + 4, 4);
    f->t_ns = mode == MODE_SLOTS ? (int64_t)get(p + 8, 8) : board_time_ns();
    memcpy(f->data, p + FRAME_HEAD, length);
}

static void tell(int32_t command)
{
    node_t *n = firmware_node();
    if (command == COMMAND_START && mode == MODE_WALL && n->start_ns == 0)
        n->asked_ns = node_origin(n, board_time_ns(), EPOCH_LEAD_NS);
    node_tell(n, command);
}

static void end_slot(int64_t slot, int32_t result)
{
    uint8_t done[16];
    put(put(put(done, (uint64_t)slot, 8), (uint64_t)(uint32_t)result, 4), heard.head.dropped, 4);
    write('d', done, sizeof done, 0, 0);
}

static void run_slot(int64_t slot, int64_t limit_ns)
{
    node_t *n = firmware_node();
    if (mode != MODE_SLOTS || slot != n->slot) {
        say("found another slot, expected ", (uint32_t)n->slot);
        end_slot(slot, -1);
        return;
    }
    memset(row.rows, 0, sizeof row.rows); /* what a short sample does not fill is 0, as in a new file */
    memset(heard.rows, 0, sizeof heard.rows);
    row.head.rows = heard.head.rows = heard.head.dropped = 0;
    const int32_t result = firmware_slot(limit_ns);
    for (uint32_t i = 0; i < heard.head.rows; i++) write('j', heard.rows + i * HEARD_SIZE, HEARD_SIZE, 0, 0);
    write('r', row.rows, ROW_SIZE, 0, 0);
    if (result) hal_log(firmware_why());
    end_slot(slot, result);
}

/* The modes begin in the program, not in the middle of a life. */
static void ask(int32_t what, const uint8_t *before)
{
    if (before) firmware_lived((uint32_t)get(before, 4));
    asked = what == MODE_SLOTS ? MODE_SLOTS : MODE_WALL;
    firmware_node()->quit = 1;
}

static void obey(char type, const uint8_t *p, int32_t n)
{
    if (type == 'f') take_frame(p, n);
    else if (type == 's' && n == 16) run_slot((int64_t)get(p, 8), (int64_t)get(p + 8, 8));
    else if (type == 't' && n == 1) tell(p[0]);
    else if (type == 'm' && (n == 1 || n == 5)) ask(p[0], n == 5 ? p + 1 : NULL);
    else if (type == 'q') ended = 1, firmware_node()->quit = 1;
    else skipped++;
}

/* Length of the record at the beginning of the input; 0: it is not whole yet; -1: there is none. */
static int32_t record(const uint8_t *p, int32_t n)
{
    if (p[0] != MAGIC) return -1;
    if (n < HEAD) return 0;
    const int32_t length = (int32_t)get(p + 2, 2), all = HEAD + length + 2;
    if (length > LONGEST) return -1;
    if (n < all) return 0;
    return crc16_ccitt(0xFFFF, p + 1, all - 3) == get(p + all - 2, 2) ? all : -1;
}

/* Carries out the records that have come, up to one that changes the mode. */
static void look(void)
{
    int32_t at = 0, n;
    n_input += board_read(input + n_input, INPUT - n_input);
    while (at < n_input && asked == MODE_NONE && (n = record(input + at, n_input - at)) != 0) {
        const int32_t here = at;
        at += n < 0 ? 1 : n;
        if (n < 0) skipped++;
        else obey((char)input[here + 1], input + here + HEAD, n - HEAD - 2);
    }
    n_input -= at;
    memmove(input, input + at, (size_t)n_input);
}

/* --- the HAL -------------------------------------------------------------------------------------- */

int64_t hal_time_ns(void) { return board_time_ns(); }

int32_t hal_can_send(int32_t bus, const frame_t *f)
{
    uint8_t head[FRAME_HEAD];
    put(put(put(put(put(put(head, (uint64_t)bus, 1), f->flags, 1), f->length, 1), 0, 1), f->id, 4), 0, 8);
    write('f', head, FRAME_HEAD, f->data, f->length);
    return 0;
}

int32_t hal_can_receive(int32_t bus, frame_t *frame)
{
    queue_t *q = received + bus;
    if (mode == MODE_WALL) look();
    if (q->head == q->tail) return 0;
    *frame = q->frames[q->tail++ & (QUEUE - 1)];
    return 1;
}

void hal_torque(int32_t outlet, const double *tau, int32_t n) { (void)outlet, (void)tau, (void)n; }

void hal_log(const char *text) { write('l', text, (int32_t)strlen(text), 0, 0); }

void hal_idle(int64_t until_ns)
{
    look();
    board_sleep(until_ns);
    look();
}

/* --- the program ---------------------------------------------------------------------------------- */

static void begin_slots(void)
{
    node_t *n = firmware_node();
    const char *why = firmware_begin(CLOCK_SIMULATED);
    if (why) hal_log(why);
    memset(&row, 0, sizeof row);
    memset(&heard, 0, sizeof heard);
    row.head.row_size = ROW_SIZE, row.head.capacity = row.head.limit = 1;
    heard.head.row_size = HEARD_SIZE, heard.head.capacity = heard.head.limit = HEARD_ROWS;
    n->journal = &row.head, n->heard = &heard.head;
    hello();
}

static void begin(void)
{
    mode = asked, asked = MODE_NONE;
    memset(received, 0, sizeof received);
    if (mode == MODE_SLOTS) {
        begin_slots();
        return;
    }
    firmware_begin(CLOCK_WALL);
    hello();
    const int32_t result = firmware_live();
    say(result < 0 ? "ended with -" : "ended with ", (uint32_t)(result < 0 ? -result : result));
    if (asked == MODE_NONE) mode = MODE_NONE;
}

int main(void)
{
    while (!ended) {
        hal_idle(board_time_ns() + 1000000000);
        if (asked != MODE_NONE) begin();
    }
    say("bytes skipped: ", skipped);
    say("frames lost: ", lost);
    say("stack used, bytes: ", board_stack());
    board_end();
    return 0;
}
