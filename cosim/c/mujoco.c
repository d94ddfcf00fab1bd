/* mujoco.c: one step of a scene: inputs, mj_step as often as needed, outputs.
 *
 * MuJoCo reports errors and warnings through two global function pointers, and its own handler ends the
 * process after an error. The handler of errors here leaves the step instead (longjmp, which MuJoCo allows
 * for errors only). A step with a warning fails at its end: MuJoCo then has left out contacts, or has reset
 * a state that diverged.
 */
#include "mujoco.h"

#include <setjmp.h>
#include <stdlib.h>

typedef void (*advance_t)(const void *model, void *data);
typedef void (*handler_t)(const char *text);

#if defined(_MSC_VER)
#define THREAD __declspec(thread)
#else
#define THREAD __thread
#endif

/* The scene that this thread steps, and where its step is left; what listens to warnings between steps. */
static THREAD mujoco_t *stepped, *listening;
static THREAD jmp_buf left;

/* The step has failed: the first reason counts. */
static void fail(mujoco_t *x, const char *text)
{
    size_t n = 0;
    if (x->failed) return;
    while (text[n] && n < MUJOCO_TEXT - 1) n++;
    memcpy(x->text, text, n);
    x->text[n] = 0;
    x->failed = 1;
}

/* Outside of a step nothing can be left: an error ends the process, as MuJoCo does without a handler. */
static void on_error(const char *text)
{
    if (stepped) {
        fail(stepped, text);
        longjmp(left, 1);
    }
    fprintf(stderr, "MuJoCo: %s\n", text);
    abort();
}

static void on_warning(const char *text)
{
    if (stepped || listening) fail(stepped ? stepped : listening, text);
    else fprintf(stderr, "MuJoCo: %s\n", text);
}

/* Put the handlers at mju_user_error and mju_user_warning, whose addresses are given. */
API void mujoco_handlers(void **error, void **warning)
{
    const handler_t e = on_error, w = on_warning;
    memcpy(error, &e, sizeof e);
    memcpy(warning, &w, sizeof w);
}

/* Keep the first warning outside of steps, as while a file is read, in x->text; NULL: no longer. */
API void mujoco_listen(mujoco_t *x) { listening = x; }

static void call(void *function, const mujoco_t *x)
{
    advance_t f;
    memcpy(&f, &function, sizeof f);
    f(x->model, x->data);
}

static void take(const mujoco_t *x, const double *inputs)
{
    for (int64_t i = 0; i < x->n_applied; i++) *(double *)x->applied[i] = 0.0;
    for (int64_t i = 0; i < x->n_inputs; i++) *(double *)x->targets[i] += x->gains[i] * inputs[i];
}

static void give(const mujoco_t *x, double *outputs)
{
    for (int64_t i = 0; i < x->n_outputs; i++)
        outputs[i] = 0.0 + x->scales[i] * *(const double *)x->sources[i];
}

/* After a failure nothing is called any more: the data may be in any state until it is reset. */
static int32_t run(mujoco_t *x, int64_t steps, const double *inputs, double *outputs)
{
    if (x->failed) return 1;
    if (setjmp(left)) {
        stepped = NULL;
        return 1;
    }
    stepped = x;
    take(x, inputs);
    for (int64_t i = 0; i < steps && !x->failed; i++) call(x->advance, x);
    if (x->evaluate && !x->failed) call(x->evaluate, x);
    stepped = NULL;
    if (x->failed) return 1;
    give(x, outputs);
    return 0;
}

/* The outputs for the inputs given, without a step. Returns 0, or 1 with the reason in x->text. */
API int32_t mujoco_outputs(mujoco_t *x, const double *inputs, double *outputs)
{
    return run(x, 0, inputs, outputs);
}

/* native_t: the scene counts its own time, in whole steps. Returns 0, or 1 as above. */
API int32_t mujoco_step(void *instance, double t, double h, const double *inputs, double *outputs)
{
    mujoco_t *x = instance;
    (void)t, (void)h;
    return run(x, x->substeps, inputs, outputs);
}
