/* abdessameud2014.c - adaptive consensus with a filter of second order as reference, of the planar arm. */
#include "abdessameud2014.h"
