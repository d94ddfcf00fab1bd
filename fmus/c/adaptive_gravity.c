/* adaptive_gravity.c - the adaptive law for one arm alone, with gravity. */
#define NETWORKED 0
#define GRAVITY 1
#include "adaptive_law.h"
