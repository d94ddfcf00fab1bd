/* lanes_8.c - a model's step of eight instances at once, with AVX-512. */
#include "wide.h"

#if CHOOSES_LANES
#include <stddef.h>
#include <math.h>

#ifdef __clang__
#pragma clang attribute push(__attribute__((target("avx512f,avx512dq"))), apply_to = function)
#else
#pragma GCC target("avx512f,avx512dq")
#endif

typedef long long Signs __attribute__((vector_size(64)));

#define TOGETHER 8
#define SIGNS(truth) (unsigned char)__builtin_ia32_cvtq2mask512((Signs)(truth))
#define model_step model_step_8
#define WIDE_STEPS wide_steps_8
#include "lanes_model.h"
#include "lanes.h"

#ifdef __clang__
#pragma clang attribute pop
#endif
#endif
