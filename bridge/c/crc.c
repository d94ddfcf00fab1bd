/* crc.c: see crc.h.
 *
 * The tables are written by the compiler: a CRC is linear, so the entry of a byte is the sum
 * (exclusive or) of the entries of its bits. The entry of one bit is the polynomial shifted through
 * as many zero bits as follow it, and through 8 more for each byte that follows (four bytes at once).
 */
#include "crc.h"

#define SUM(i, b0, b1, b2, b3, b4, b5, b6, b7)                                               \
    (((i) & 1 ? b0 : 0u) ^ ((i) & 2 ? b1 : 0u) ^ ((i) & 4 ? b2 : 0u) ^ ((i) & 8 ? b3 : 0u) ^ \
     ((i) & 16 ? b4 : 0u) ^ ((i) & 32 ? b5 : 0u) ^ ((i) & 64 ? b6 : 0u) ^ ((i) & 128 ? b7 : 0u))
#define FOUR(E, i) E((i)), E((i) + 1), E((i) + 2), E((i) + 3)
#define SIXTEEN(E, i) FOUR(E, i), FOUR(E, (i) + 4), FOUR(E, (i) + 8), FOUR(E, (i) + 12)
#define QUARTER(E, i) SIXTEEN(E, i), SIXTEEN(E, (i) + 16), SIXTEEN(E, (i) + 32), SIXTEEN(E, (i) + 48)
#define TABLE(E) {QUARTER(E, 0), QUARTER(E, 64), QUARTER(E, 128), QUARTER(E, 192)}

#define H2F(i) SUM(i, 0x2F, 0x5E, 0xBC, 0x57, 0xAE, 0x73, 0xE6, 0xE3)
#define CCITT(i) SUM(i, 0x1021, 0x2042, 0x4084, 0x8108, 0x1231, 0x2462, 0x48C4, 0x9188)
#define CCITT_1(i) SUM(i, 0x3331, 0x6662, 0xCCC4, 0x89A9, 0x0373, 0x06E6, 0x0DCC, 0x1B98)
#define CCITT_2(i) SUM(i, 0x3730, 0x6E60, 0xDCC0, 0xA9A1, 0x4363, 0x86C6, 0x1DAD, 0x3B5A)
#define CCITT_3(i) SUM(i, 0x76B4, 0xED68, 0xCAF1, 0x85C3, 0x1BA7, 0x374E, 0x6E9C, 0xDD38)
#define P4(i)                                                                                         \
    SUM(i, 0x30850FF5u, 0x610A1FEAu, 0xC2143FD4u, 0x159615F7u, 0x2B2C2BEEu, 0x565857DCu, 0xACB0AFB8u, \
        0xC8DF352Fu)

static const uint8_t TABLE8[256] = TABLE(H2F);
static const uint16_t TABLE16[4][256] = {TABLE(CCITT), TABLE(CCITT_1), TABLE(CCITT_2), TABLE(CCITT_3)};
static const uint32_t TABLE32[256] = TABLE(P4);

uint8_t crc8_h2f(uint8_t state, const uint8_t *data, int32_t n)
{
    int32_t i;
    for (i = 0; i < n; i++) state = TABLE8[state ^ data[i]];
    return state;
}

uint16_t crc16_ccitt(uint16_t state, const uint8_t *data, int32_t n)
{
    int32_t i;
    for (i = 0; i + 4 <= n; i += 4)
        state = (uint16_t)(TABLE16[3][(state >> 8) ^ data[i]] ^ TABLE16[2][(state & 0xFF) ^ data[i + 1]] ^
                           TABLE16[1][data[i + 2]] ^ TABLE16[0][data[i + 3]]);
    for (; i < n; i++) state = (uint16_t)((state << 8) ^ TABLE16[0][(state >> 8) ^ data[i]]);
    return state;
}

uint32_t crc32_p4(uint32_t state, const uint8_t *data, int32_t n)
{
    int32_t i;
    for (i = 0; i < n; i++) state = (state >> 8) ^ TABLE32[(state ^ data[i]) & 0xFF];
    return state;
}
