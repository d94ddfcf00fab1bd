/* parser.c: a receiver of frames, bit by bit: destuffing, fields, CRC. */
#include "internal.h"

void parser_begin(parser_t *p)
{
    memset(p, 0, sizeof *p);
    p->left = 11;
    p->run = 1; /* the start of frame, dominant */
    p->crc17 = 1u << 16;
    p->crc21 = 1u << 20;
    parser_feed(p, -1);
}

static void crc_step(uint32_t *crc, uint32_t bit, int32_t width, uint32_t polynomial)
{
    uint32_t high = (*crc >> (width - 1) ^ bit) & 1u;
    *crc = (*crc << 1 & ((1u << width) - 1u)) ^ (high ? polynomial : 0u);
}

static void fd_crc(parser_t *p, uint32_t bit)
{
    crc_step(&p->crc17, bit, 17, 0x1685Bu);
    crc_step(&p->crc21, bit, 21, 0x102899u);
}

static void go(parser_t *p, int32_t field, int32_t bits)
{
    p->field = field;
    p->left = bits;
    p->value = 0;
    p->got = 0;
}

static void data_follows(parser_t *p)
{
    static const uint8_t lengths[16] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64};
    int32_t fd = p->frame.flags & CAN_FD, code = (int32_t)p->value;
    p->frame.length = fd || code < 8 ? lengths[code] : 8;
    if (p->frame.length && !(p->frame.flags & CAN_REMOTE)) go(p, FIELD_DATA, 8 * p->frame.length);
    else if (fd) go(p, FIELD_FD_CRC, p->frame.length <= 16 ? 27 : 32);
    else go(p, FIELD_CRC, 15);
}

/* One bit of the CRC field of an FD frame: every fifth is a fixed stuff bit. */
static int32_t fd_crc_bit(parser_t *p, uint32_t bit)
{
    static const uint8_t gray[8] = {0, 3, 6, 5, 12, 15, 10, 9};
    int32_t first = p->frame.length <= 16 ? 27 : 32, at = first - p->left;
    int32_t before = p->last;
    p->last = (int32_t)bit;
    p->left--;
    if (at % 5 == 0) return (int32_t)bit == before ? ERROR_FORM : 0;
    p->value = p->value << 1 | bit;
    if (at < 5) fd_crc(p, bit);
    if (at == 4) {
        p->crc_ok = p->value == gray[p->stuffed & 7];
        p->value = 0;
    }
    if (p->left == 0) {
        p->crc_ok &= p->value == (first == 27 ? p->crc17 : p->crc21);
        go(p, FIELD_DELIMITER, 1);
    }
    return 0;
}

static void flag(parser_t *p, uint32_t bit, uint32_t flag)
{
    if (bit) p->frame.flags |= (uint8_t)flag;
}

/* From the identifier to the data. */
static int32_t header_bit(parser_t *p, uint32_t bit)
{
    int32_t extended = p->frame.flags & CAN_EXTENDED;
    p->value = p->value << 1 | bit;
    if (p->field == FIELD_DATA && p->left % 8 == 1) p->frame.data[p->got++] = (uint8_t)p->value;
    if (--p->left > 0) return 0;
    switch (p->field) {
    case FIELD_BASE:
        p->frame.id = p->value;
        go(p, FIELD_RTR, 1);
        break;
    case FIELD_RTR:
        flag(p, bit, CAN_REMOTE);
        go(p, FIELD_IDE, 1);
        break;
    case FIELD_IDE:
        flag(p, bit, CAN_EXTENDED);
        go(p, bit ? FIELD_EXTENSION : FIELD_FDF, bit ? 18 : 1);
        break;
    case FIELD_EXTENSION:
        p->frame.id = p->frame.id << 18 | p->value;
        p->frame.flags &= (uint8_t)~CAN_REMOTE; /* what was there is SRR */
        go(p, FIELD_EXTENDED_RTR, 1);
        break;
    case FIELD_EXTENDED_RTR:
        flag(p, bit, CAN_REMOTE);
        go(p, FIELD_FDF, 1);
        break;
    case FIELD_FDF:
        if (bit) {
            p->frame.flags = (uint8_t)((p->frame.flags & ~CAN_REMOTE) | CAN_FD);
            go(p, FIELD_RES, 1);
        } else {
            go(p, extended ? FIELD_R0 : FIELD_DLC, extended ? 1 : 4);
        }
        break;
    case FIELD_R0: go(p, FIELD_DLC, 4); break;
    case FIELD_RES: go(p, FIELD_BRS, 1); return bit ? ERROR_FORM : 0;
    case FIELD_BRS:
        flag(p, bit, CAN_BRS);
        go(p, FIELD_ESI, 1);
        break;
    case FIELD_ESI:
        flag(p, bit, CAN_ESI);
        go(p, FIELD_DLC, 4);
        break;
    case FIELD_DLC: data_follows(p); break;
    default:
        if (p->frame.flags & CAN_FD) go(p, FIELD_FD_CRC, p->frame.length <= 16 ? 27 : 32);
        else go(p, FIELD_CRC, 15);
    }
    return 0;
}

/* From the CRC delimiter to the end of frame. */
static int32_t tail_bit(parser_t *p, uint32_t bit)
{
    switch (p->field) {
    case FIELD_DELIMITER: go(p, FIELD_ACK, 1); return bit ? 0 : ERROR_FORM;
    case FIELD_ACK: go(p, FIELD_ACK_DELIMITER, 1); return 0;
    case FIELD_ACK_DELIMITER: go(p, FIELD_EOF, 7); return !bit ? ERROR_FORM : p->crc_ok ? 0 : ERROR_CRC;
    default:
        if (--p->left == 0) return bit ? PARSED_FRAME : PARSED_OVERLOAD;
        return bit ? 0 : ERROR_FORM;
    }
}

/* Feed -1 for a start of frame, then its bits. Returns 0, ERROR_ or PARSED_. */
int32_t parser_feed(parser_t *p, int32_t level)
{
    uint32_t bit = level > 0;
    if (level < 0) {
        crc_step(&p->crc15, 0, 15, 0x4599u);
        fd_crc(p, 0);
        return 0;
    }
    if (p->field == FIELD_FD_CRC) return fd_crc_bit(p, bit);
    if (p->field <= FIELD_CRC || (p->field == FIELD_DELIMITER && p->run == 5 && !(p->frame.flags & CAN_FD))) {
        int32_t due = p->run == 5;
        if (due && level == p->last) return ERROR_STUFF;
        p->run = level == p->last ? p->run + 1 : 1;
        p->last = level;
        if (p->field < FIELD_CRC) fd_crc(p, bit);
        p->stuffed += due;
        if (due) return 0;
    }
    if (p->field < FIELD_CRC) {
        crc_step(&p->crc15, bit, 15, 0x4599u);
        return header_bit(p, bit);
    }
    if (p->field > FIELD_CRC) return tail_bit(p, bit);
    p->value = p->value << 1 | bit;
    if (--p->left == 0) {
        p->crc_ok = p->value == p->crc15;
        go(p, FIELD_DELIMITER, 1);
    }
    return 0;
}
