/* servo.h - the limits of a reference's velocity, for a servo and for who commands it. */
#ifndef SERVO_H
#define SERVO_H

#include "limit.h"

enum { VELOCITY, POSITION }; /* values of the parameter `mode` */

/* The velocity that v_max and a_max leave of `asked`, h after `before`. */
static inline double limited_rate(double asked, double before, double v_max, double a_max, double h)
{
    const double allowed = limited(asked, v_max), most = a_max * h, change = allowed - before;
    return change > most ? before + most : change < -most ? before - most : allowed;
}

#define SERVO_DIVERGED "the servo left the range of numbers: the motion diverged"

#endif
