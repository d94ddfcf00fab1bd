/* arm_chopra.c - adaptive synchronisation of r = dq + lambda q, of a serial arm. */
#define SERIAL_ARM 1
#include "chopra.h"
