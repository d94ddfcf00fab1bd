/* outlet.h: outputs of a component: torques guarded, values encoded and sent. */
#ifndef BRIDGE_OUTLET_H
#define BRIDGE_OUTLET_H

#include "node.h"

/* `passing` of engine gates: an outlet; a torque that stays inside the node. */
API int32_t outlet_pass(void *context, int64_t tick, double *signals);
API int32_t inside_pass(void *context, int64_t tick, double *signals);
/* A message of an outlet, with the values it has; its time stamp is the nominal time of this sample, so
 * receivers know how old it is, and which one, however late the node was. */
void outlet_send_sample(outlet_t *o, int64_t sequence, int64_t now_ns);
/* Before the first slot: its first message, without torque. */
void outlet_tell(outlet_t *o, int64_t now_ns);

#endif
