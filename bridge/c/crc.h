/* crc.h: the three checksums of AUTOSAR's end-to-end profiles, without the final inversion: a
 * state goes in and comes out, so that parts can be added. n in bytes.
 *
 * Source: AUTOSAR FO "Specification of CRC Routines" (polynomials, start values, check values).
 */
#ifndef BRIDGE_CRC_H
#define BRIDGE_CRC_H

#include <stdint.h>

uint8_t crc8_h2f(uint8_t state, const uint8_t *data, int32_t n);      /* 0x2F, start and final 0xFF */
uint16_t crc16_ccitt(uint16_t state, const uint8_t *data, int32_t n); /* 0x1021, start 0xFFFF */
uint32_t crc32_p4(uint32_t state, const uint8_t *data, int32_t n);    /* 0xF4ACFB13 reflected, both ~0 */

#endif
