/* arm_task_turn.c - the adaptive law in place and turn of the arm's tip, with neighbours. */
#define NETWORKED 1
#define TASK 1
#define TURN 1
#include "arm_law.h"
