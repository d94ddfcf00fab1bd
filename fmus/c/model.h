/* model.h - what the C file of a model includes: its variables, and the functions it provides.
 *
 * A model's variables lie in one struct of Real, `Model`, generated with `variables.h` from the
 * model's declaration. A model does not depend on FMI.
 */
#ifndef MODEL_H
#define MODEL_H

#include "declaration.h"
#include "variables.h"

/* The number of entries of a variable of the model, a constant. */
#define ENTRIES(variable) ((int)(sizeof((Model *)0)->variable / sizeof(Real)))

/* Of the `most` joints that the arrays of a model `x` have room for, those that there are: all, or with a
 * structural parameter (FMI 3.0) as many as it says. */
#ifdef STRUCTURAL
#define COUNT(x, most) ((int)COMMON((x)->STRUCTURAL))
#else
#define COUNT(x, most) ((void)(x), (most))
#endif

#endif
