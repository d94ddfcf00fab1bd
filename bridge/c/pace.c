/* pace.c: see pace.h */
#define _GNU_SOURCE
#include "pace.h"
