/* e2e.c: the end-to-end headers of AUTOSAR FO "E2E Protocol Specification", see e2e.h.
 *
 *   P02   0 CRC8   1 counter in the low 4 bits       CRC of bytes 1.., then dataIDs[counter]
 *   P05   0 CRC16 little endian   2 counter          CRC of bytes 2.., then the data ID, low byte first
 *   P04   0 length   2 counter   4 data ID   8 CRC32, all big endian      CRC of bytes 0-7, 12..
 */
#include "e2e.h"

#include <stddef.h>

#include "crc.h"

static uint32_t read_big_endian(const uint8_t *p, int32_t n)
{
    uint32_t value = 0;
    while (n--) value = value << 8 | *p++;
    return value;
}

static void put_big(uint8_t *p, int32_t n, uint32_t value)
{
    for (; n--; value >>= 8) p[n] = (uint8_t)value;
}

static uint8_t crc_p02(const uint8_t *data_ids, const uint8_t *data, int32_t length)
{
    uint8_t state = crc8_h2f(0xFF, data + 1, length - 1);
    return (uint8_t)(crc8_h2f(state, data_ids + (data[1] & 15), 1) ^ 0xFF);
}

static uint16_t crc_p05(const uint8_t *data_ids, const uint8_t *data, int32_t length)
{
    return crc16_ccitt(crc16_ccitt(0xFFFF, data + 2, length - 2), data_ids, 2);
}

static uint32_t crc_p04(const uint8_t *data, int32_t length)
{
    return ~crc32_p4(crc32_p4(~(uint32_t)0, data, 8), data + 12, length - 12);
}

static uint32_t id_p04(const uint8_t *data_ids)
{
    return data_ids[0] | (uint32_t)data_ids[1] << 8 | (uint32_t)data_ids[2] << 16 |
           (uint32_t)data_ids[3] << 24;
}

void e2e_protect(int32_t profile, const uint8_t *data_ids, uint32_t counter, uint8_t *data, int32_t length)
{
    if (profile == E2E_P02) {
        data[1] = (uint8_t)((data[1] & 0xF0) | (counter & 15));
        data[0] = crc_p02(data_ids, data, length);
    } else if (profile == E2E_P05) {
        uint16_t crc;
        data[2] = (uint8_t)counter;
        crc = crc_p05(data_ids, data, length);
        data[0] = (uint8_t)crc;
        data[1] = (uint8_t)(crc >> 8);
    } else if (profile == E2E_P04) {
        put_big(data, 2, (uint32_t)length);
        put_big(data + 2, 2, counter);
        put_big(data + 4, 4, id_p04(data_ids));
        put_big(data + 8, 4, crc_p04(data, length));
    }
}

int32_t e2e_check(int32_t profile, const uint8_t *data_ids, const uint8_t *data, int32_t length,
                  uint32_t *counter)
{
    int32_t wrong = 0;
    if (length < (profile == E2E_P04 ? 12 : profile == E2E_P05 ? 3 : profile == E2E_P02 ? 2 : 0))
        return DECODE_LENGTH;
    if (profile == E2E_P04 && read_big_endian(data, 2) != (uint32_t)length) return DECODE_LENGTH;
    if (profile == E2E_P02) wrong = data[0] != crc_p02(data_ids, data, length);
    else if (profile == E2E_P05) wrong = (data[0] | data[1] << 8) != crc_p05(data_ids, data, length);
    else if (profile == E2E_P04)
        wrong = read_big_endian(data + 8, 4) != crc_p04(data, length) ||
                read_big_endian(data + 4, 4) != id_p04(data_ids);
    if (wrong) return DECODE_CRC;
    *counter = profile == E2E_P02   ? data[1] & 15u
               : profile == E2E_P05 ? data[2]
               : profile == E2E_P04 ? read_big_endian(data + 2, 2)
                                    : 0;
    return DECODE_OK;
}
