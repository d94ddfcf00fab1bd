/* arm_task.c - the adaptive law in the coordinates of the arm's tip, with neighbours. */
#define NETWORKED 1
#define TASK 1
#define TURN 0
#include "arm_law.h"
