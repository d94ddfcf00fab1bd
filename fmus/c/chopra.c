/* chopra.c - adaptive synchronisation of r = dq + lambda q, of the planar arm. */
#include "chopra.h"
