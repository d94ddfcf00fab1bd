/* inlet.h: received values as inputs of a node's components. */
#ifndef BRIDGE_INLET_H
#define BRIDGE_INLET_H

#include "node.h"

/* `passing` of engine gates. */
API int32_t inlet_pass(void *context, int64_t tick, double *signals);

#endif
