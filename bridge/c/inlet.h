/* inlet.h: what a node gives its components of what it has received. */
#ifndef BRIDGE_INLET_H
#define BRIDGE_INLET_H

#include "node.h"

/* `passing` of engine gates. */
API int32_t inlet_pass(void *context, int64_t tick, double *signals);

#endif
