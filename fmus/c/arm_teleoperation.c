/* arm_teleoperation.c - the adaptive law for a serial arm with neighbours. */
#define NETWORKED 1
#include "arm_law.h"
