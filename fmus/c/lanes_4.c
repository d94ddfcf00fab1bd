/* lanes_4.c - a model's step of four instances at once, with AVX2 on x86-64. */
#include "wide.h"

#if HAS_LANES
#include <stddef.h>
#include <math.h>

#if CHOOSES_LANES /* x86-64, where a processor may have no AVX2 */
#ifdef __clang__
#pragma clang attribute push(__attribute__((target("avx2"))), apply_to = function)
#else
#pragma GCC target("avx2")
#endif
#define SIGNS(truth) __builtin_ia32_movmskpd256((Real)(truth))
#endif

#define TOGETHER 4
#define model_step model_step_4
#define WIDE_STEPS wide_steps_4
#include "lanes_model.h"
#include "lanes.h"

#if CHOOSES_LANES && defined(__clang__)
#pragma clang attribute pop
#endif
#endif
