/* arm_teleoperation.c - the adaptive law for a serial arm with neighbours. */
#define NETWORKED 1
#define TASK 0
#include "arm_law.h"
