/* vendor_cia402.h: CiA 402 drives, cyclic synchronous torque. */
#ifndef BRIDGE_VENDOR_CIA402_H
#define BRIDGE_VENDOR_CIA402_H

#include "vendor_kind.h"

extern const vendor_kind_t vendor_cia402;

#endif
