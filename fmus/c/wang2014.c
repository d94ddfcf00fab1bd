/* wang2014.c - adaptive consensus with static feedback, of the planar arm. */
#include "wang2014.h"
