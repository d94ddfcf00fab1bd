/* arm_nuno_adaptive.c - adaptive synchronisation of positions, of a serial arm. */
#define SERIAL_ARM 1
#include "nuno_adaptive.h"
