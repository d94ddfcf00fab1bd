/* e2e.h: the headers of AUTOSAR's end-to-end profiles: checksum and counter. */
#ifndef BRIDGE_E2E_H
#define BRIDGE_E2E_H

#include <stdint.h>

#include "frame.h"

enum E2E_profile { E2E_NONE = 0, E2E_P02 = 2, E2E_P04 = 4, E2E_P05 = 5 };
/* What became of a frame that was checked and decoded (message.h). */
enum decoded { DECODE_OK, DECODE_LENGTH, DECODE_CRC, DECODE_INVALID, DECODE_RANGE };

/* The protection alone, for bytes that are not made of fields: `data` has room for the header of the
 * profile (P02: 2, P05: 3, P04: 12 bytes) at its start. */
API void e2e_protect(int32_t profile, const uint8_t *data_ids, uint32_t counter, uint8_t *data,
                     int32_t length);
/* DECODE_OK and the counter, DECODE_LENGTH (too short; P04: another length inside) or DECODE_CRC. */
API int32_t e2e_check(int32_t profile, const uint8_t *data_ids, const uint8_t *data, int32_t length,
                      uint32_t *counter);

#endif
