/* vendor_damiao.h: Damiao drives in MIT mode. */
#ifndef BRIDGE_VENDOR_DAMIAO_H
#define BRIDGE_VENDOR_DAMIAO_H

#include "vendor_kind.h"

extern const vendor_kind_t vendor_damiao;

#endif
