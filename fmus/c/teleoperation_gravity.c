/* teleoperation_gravity.c - the adaptive law for an arm with neighbours, with gravity. */
#define NETWORKED 1
#define GRAVITY 1
#include "adaptive_law.h"
