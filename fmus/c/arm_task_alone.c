/* arm_task_alone.c - the adaptive law in the coordinates of the arm's tip, for one arm alone. */
#define NETWORKED 0
#define TASK 1
#define TURN 0
#include "arm_law.h"
