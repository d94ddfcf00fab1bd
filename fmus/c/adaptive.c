/* adaptive.c - the adaptive law for one arm alone. */
#define NETWORKED 0
#define GRAVITY 0
#include "adaptive_law.h"
