/* node.c: a controller, bit by bit: transmission, reception, error signalling.
 *
 * Rules 1 to 12 are those of fault confinement in Bosch, CAN 2.0 B, section 8 (ISO 11898-1).
 */
#include "internal.h"

enum { REC_BACK = 127 }; /* what rule 8 makes of a REC above */

/* Count more, without an error flag (rules 2 and 6). */
static void count_more(bus_t *b, int32_t node)
{
    node_t *n = &b->nodes[node];
    if (n->sender) n->tec += 8;
    else count_received(b, n, n->rec + 8);
    node_confine(b, node);
}

/* An error: count it, and send an error flag from the next bit on. The error that makes a node
 * passive is still answered with an active flag (rule 9). */
static void fail(bus_t *b, int32_t node, int32_t code, int32_t count)
{
    node_t *n = &b->nodes[node];
    int32_t passive = node_passive(n), others = b->flags - n->flagging;
    int32_t role = (others ? 0 : ROLE_PRIMARY) | (n->sender ? ROLE_SENDER : 0);
    int64_t request = n->slot == NO_SLOT ? b->on_air : n->slots[n->slot].request;
    if (n->sender) n->tec += count;
    else count_received(b, n, n->rec + count);
    event_at_bit(b, node, EVENT_ERROR, code, request, role, b->bit);
    node_failed(b, node);
    node_confine(b, node);
    b->troubled = 1;
    if (n->phase == PHASE_OFF) return;
    n->phase = passive ? PHASE_PASSIVE_FLAG : PHASE_ACTIVE_FLAG;
    n->count = 0;
    n->last = -1;
    n->after_error = 1;
    n->ack_pending = 0;
}

static void overload(bus_t *b, int32_t node)
{
    node_t *n = &b->nodes[node];
    n->phase = PHASE_OVERLOAD_FLAG;
    n->count = 0;
    n->after_error = 0;
    b->troubled = 1;
    event_at_bit(b, node, EVENT_OVERLOAD, 0, -1, 0, b->bit);
}

static void enter(node_t *n, int32_t phase, int32_t count)
{
    n->phase = phase;
    n->count = count;
}

/* Begin to send: at the start of frame, or (after_start) behind one that another node sent. */
void node_begin(bus_t *b, int32_t node, int32_t after_start)
{
    node_t *n = &b->nodes[node];
    can_frame_t f;
    if (n->slot == NO_SLOT) n->slot = n->order[0];
    f = node_frame(n, n->slot);
    n->n_wire = wire_bits(&f, n->wire);
    n->position = after_start;
    n->sender = 1;
    clock_align(n);
    enter(n, PHASE_FRAME, after_start); /* counts who joined: wire.c, join */
    parser_begin(&n->parser);
    event_at_bit(b, node, EVENT_STARTED, 0, n->slots[n->slot].request, 0, 0);
}

static void listen(bus_t *b, int32_t node)
{
    node_t *n = &b->nodes[node];
    n->sender = 0;
    n->earliest = 0;
    clock_align(n);
    refresh(b, node);
    enter(n, PHASE_FRAME, 0);
    parser_begin(&n->parser);
}

int32_t node_drive(bus_t *b, int32_t node)
{
    node_t *n = &b->nodes[node];
    if (n->phase == PHASE_ACTIVE_FLAG || n->phase == PHASE_OVERLOAD_FLAG) return 0;
    if (n->phase != PHASE_FRAME) return 1;
    if (n->sender) return n->wire[n->position] & WIRE_VALUE;
    return !(n->parser.field == FIELD_ACK && n->parser.crc_ok);
}

static void receive(bus_t *b, int32_t node, int32_t bit)
{
    node_t *n = &b->nodes[node];
    int32_t acknowledge = n->parser.field == FIELD_ACK && n->parser.crc_ok;
    int32_t found = parser_feed(&n->parser, bit);
    if (acknowledge && bit) {
        fail(b, node, ERROR_BIT, 1);
    } else if (acknowledge) { /* rule 8 */
        count_received(b, n, n->rec > REC_BACK ? REC_BACK : n->rec - (n->rec > 0));
        node_confine(b, node);
    } else if (found == PARSED_FRAME || found == PARSED_OVERLOAD) {
        deliver(b, node, &n->parser.frame, b->on_air);
        if (found == PARSED_OVERLOAD) overload(b, node);
        else enter(n, PHASE_INTERMISSION, 0);
    } else if (found) {
        fail(b, node, found, 1);
    }
}

static void transmit(bus_t *b, int32_t node, int32_t bit)
{
    node_t *n = &b->nodes[node];
    int32_t kind = n->wire[n->position], sent = kind & WIRE_VALUE;
    if (kind & WIRE_ACK) {
        if (bit) {
            int32_t passive = node_passive(n);
            fail(b, node, ERROR_ACK, passive ? 0 : 8);
            n->ack_pending = passive; /* rule 3, exception 1 */
            return;
        }
    } else if (sent != bit) {
        if (!(kind & WIRE_ARBITRATION) || !sent) {
            fail(b, node, ERROR_BIT, 8);
        } else if (kind & WIRE_STUFF) { /* rule 3, exception 2 */
            fail(b, node, ERROR_STUFF, 0);
        } else {
            event_at_bit(b, node, EVENT_LOST, 0, n->slots[n->slot].request, 0, b->bit);
            n->sender = 0;
            node_failed(b, node);
            receive(b, node, bit);
        }
        return;
    }
    if (n->position > 0 && (kind & WIRE_ARBITRATION)) parser_feed(&n->parser, bit);
    if (++n->position == n->n_wire) {
        enter(n, PHASE_INTERMISSION, 0);
        node_sent(b, node, n->slot);
    }
}

static void flag_bit(bus_t *b, int32_t node, int32_t bit)
{
    node_t *n = &b->nodes[node];
    if (n->phase == PHASE_PASSIVE_FLAG) {
        if (n->ack_pending && !bit) {
            n->ack_pending = 0;
            count_more(b, node);
            if (n->phase == PHASE_OFF) return;
        }
        n->count = bit == n->last ? n->count + 1 : 1;
        n->last = bit;
    } else if (bit) { /* rules 4 and 5 */
        fail(b, node, ERROR_BIT, 8);
        return;
    } else {
        n->count++;
    }
    if (n->count == 6) enter(n, PHASE_WAIT, 0);
}

static void wait_bit(bus_t *b, int32_t node, int32_t bit)
{
    node_t *n = &b->nodes[node];
    if (bit) {
        enter(n, PHASE_DELIMITER, 1);
        return;
    }
    n->count++;
    if (n->count == 1 && n->after_error && !n->sender) /* rule 2 */
        count_more(b, node);
    if (n->count % 8 == 0 && n->phase != PHASE_OFF) /* rule 6 */
        count_more(b, node);
}

static void delimiter_bit(bus_t *b, int32_t node, int32_t bit)
{
    node_t *n = &b->nodes[node];
    n->count++;
    if (!bit && n->count < 8) fail(b, node, ERROR_FORM, n->sender ? 8 : 1);
    else if (!bit) overload(b, node);
    else if (n->count == 8) enter(n, PHASE_INTERMISSION, 0);
}

static void intermission_bit(bus_t *b, int32_t node, int32_t bit)
{
    node_t *n = &b->nodes[node];
    int32_t suspended = n->sender && node_passive(n);
    n->count++;
    if (!bit && n->count < 3) {
        overload(b, node);
    } else if (!bit) {
        int32_t joins = suspended || n->earliest > b->t ? NO_SLOT : requested(n, b->t);
        listen(b, node);
        if (joins != NO_SLOT) {
            n->slot = joins;
            node_begin(b, node, 1);
            b->joined = 1;
        }
    } else if (n->count == 3) {
        enter(n, PHASE_IDLE, 0);
        n->earliest = suspended ? b->t_end + 8 * b->set.bit : 0;
        refresh(b, node);
    }
}

void node_sample(bus_t *b, int32_t node, int32_t bit)
{
    node_t *n = &b->nodes[node];
    switch (n->phase) {
    case PHASE_IDLE:
        if (!bit) listen(b, node);
        break;
    case PHASE_FRAME:
        if (n->sender) transmit(b, node, bit);
        else receive(b, node, bit);
        break;
    case PHASE_WAIT: wait_bit(b, node, bit); break;
    case PHASE_DELIMITER: delimiter_bit(b, node, bit); break;
    case PHASE_INTERMISSION: intermission_bit(b, node, bit); break;
    case PHASE_OFF:
        n->run = bit ? n->run + 1 : 0;
        if (n->run == 11 && n->needed > 0) {
            n->run = 0;
            if (--n->needed == 0) recover(b, node);
        }
        break;
    default: flag_bit(b, node, bit);
    }
}
