/* arm_abdessameud2014.c - adaptive consensus with a filter of second order as reference, of a serial arm. */
#define SERIAL_ARM 1
#include "abdessameud2014.h"
