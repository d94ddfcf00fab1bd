/* vendor_odrive.h: ODrives, CANSimple. */
#ifndef BRIDGE_VENDOR_ODRIVE_H
#define BRIDGE_VENDOR_ODRIVE_H

#include "vendor_kind.h"

extern const vendor_kind_t vendor_odrive;

#endif
