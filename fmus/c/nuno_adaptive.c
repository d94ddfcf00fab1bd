/* nuno_adaptive.c - adaptive synchronisation of positions, of the planar arm. */
#include "nuno_adaptive.h"
