/* arm_adaptive.c - the adaptive law for one serial arm alone. */
#define NETWORKED 0
#define TASK 0
#include "arm_law.h"
