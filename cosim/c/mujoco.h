/* mujoco.h: a scene of MuJoCo as a unit of the engine (UNIT_NATIVE).
 *
 * MuJoCo is not linked: its functions and the arrays of its data come as addresses from Python, which
 * gets them from the installed version. So nothing here depends on the layout of mjModel or mjData. */
#ifndef COSIM_MUJOCO_H
#define COSIM_MUJOCO_H

#include "engine.h"

enum { MUJOCO_TEXT = 1024 };

typedef struct {
    void *model, *data;   /* mjModel, mjData */
    void *advance;        /* mj_step */
    void *evaluate;       /* mj_forward, for outputs that a step leaves old; or NULL */
    void **applied;       /* arrays of the data that inputs add to: set to zero before */
    void **targets;       /* where each input is added, */
    const double *gains;  /* times this */
    void **sources;       /* where each output is, */
    const double *scales; /* times this */
    int64_t n_applied, n_inputs, n_outputs;
    int64_t substeps;       /* time steps of the scene in a step of the unit */
    int32_t failed;         /* a step failed: the data may be in any state */
    char text[MUJOCO_TEXT]; /* what MuJoCo said */
} mujoco_t;

#endif
