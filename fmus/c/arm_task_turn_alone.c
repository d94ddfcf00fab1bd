/* arm_task_turn_alone.c - the adaptive law in place and turn of the arm's tip, for one arm alone. */
#define NETWORKED 0
#define TASK 1
#define TURN 1
#include "arm_law.h"
