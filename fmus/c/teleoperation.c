/* teleoperation.c - the adaptive law for an arm with neighbours. */
#define NETWORKED 1
#define GRAVITY 0
#include "adaptive_law.h"
