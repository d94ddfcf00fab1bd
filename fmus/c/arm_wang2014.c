/* arm_wang2014.c - adaptive consensus with static feedback, of a serial arm. */
#define SERIAL_ARM 1
#include "wang2014.h"
