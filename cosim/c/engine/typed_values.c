/* typed_values.c: values of other FMI types than float64. One call transfers all variables of one type, by way of
 * a buffer of that type. Doubles represent whole numbers exactly; other values are errors.
 */
#include "engine_internal.h"

#define EXACT 9007199254740992.0 /* 2^53: whole numbers up to here are doubles */

/* Accepts whole numbers within [low, high] only; values are never rounded. */
#define PUT(T, low, high)                                        \
    for (int64_t i = 0; i < a->count; i++) {                     \
        const double x = s[a->places[i]];                        \
        if (!(x >= (low) && x <= (high)) || (double)(T)x != x) { \
            *failed = (int32_t)a->places[i];                     \
            return RUN_VALUE;                                    \
        }                                                        \
        ((T *)a->buffer)[i] = (T)x;                              \
    }                                                            \
    break

static int convert_in(const access_t *a, const double *s, int32_t *failed)
{
    switch (a->type) {
    case TYPE_F64:
        for (int64_t i = 0; i < a->count; i++) ((double *)a->buffer)[i] = s[a->places[i]];
        break;
    case TYPE_F32:
        for (int64_t i = 0; i < a->count; i++) {
            const double x = s[a->places[i]];
            if (!(x >= -FLT_MAX && x <= FLT_MAX)) {
                *failed = (int32_t)a->places[i];
                return RUN_VALUE;
            }
            ((float *)a->buffer)[i] = (float)x;
        }
        break;
    case TYPE_I8: PUT(int8_t, INT8_MIN, INT8_MAX);
    case TYPE_U8: PUT(uint8_t, 0, UINT8_MAX);
    case TYPE_I16: PUT(int16_t, INT16_MIN, INT16_MAX);
    case TYPE_U16: PUT(uint16_t, 0, UINT16_MAX);
    case TYPE_I32: PUT(int32_t, INT32_MIN, INT32_MAX);
    case TYPE_U32: PUT(uint32_t, 0, UINT32_MAX);
    case TYPE_I64: PUT(int64_t, -EXACT, EXACT);
    case TYPE_U64: PUT(uint64_t, 0, EXACT);
    case TYPE_BOOL2: PUT(int32_t, 0, 1);
    default: PUT(_Bool, 0, 1);
    }
    return RUN_OK;
}

#define GET(T)                                                                            \
    for (int64_t i = 0; i < a->count; i++) s[a->places[i]] = (double)((T *)a->buffer)[i]; \
    break
#define GET_EXACT(T)                              \
    for (int64_t i = 0; i < a->count; i++) {      \
        const T x = ((T *)a->buffer)[i];          \
        s[a->places[i]] = (double)x;              \
        if (x > (T)EXACT || (double)x < -EXACT) { \
            *failed = (int32_t)a->places[i];      \
            return RUN_VALUE;                     \
        }                                         \
    }                                             \
    break

static int convert_out(const access_t *a, double *s, int32_t *failed)
{
    switch (a->type) {
    case TYPE_F64: GET(double);
    case TYPE_F32: GET(float);
    case TYPE_I8: GET(int8_t);
    case TYPE_U8: GET(uint8_t);
    case TYPE_I16: GET(int16_t);
    case TYPE_U16: GET(uint16_t);
    case TYPE_I32: GET(int32_t);
    case TYPE_U32: GET(uint32_t);
    case TYPE_I64: GET_EXACT(int64_t);
    case TYPE_U64: GET_EXACT(uint64_t);
    case TYPE_BOOL2:
        for (int64_t i = 0; i < a->count; i++) s[a->places[i]] = ((int32_t *)a->buffer)[i] != 0;
        break;
    default:
        for (int64_t i = 0; i < a->count; i++) s[a->places[i]] = ((unsigned char *)a->buffer)[i] != 0;
    }
    return RUN_OK;
}

SHARED int call_access(const access_t *a, void *instance)
{
    const size_t n = (size_t)a->n_references;
    if (a->fmi == 2) return ((access2_t)a->call)(instance, a->references, n, a->buffer);
    return ((access3_t)a->call)(instance, a->references, n, a->buffer, (size_t)a->count);
}

SHARED int set_typed(const access_t *a, int64_t n, void *instance, const double *s, int *status,
                     int32_t *failed)
{
    for (int64_t i = 0; i < n; i++) {
        const int result = convert_in(a + i, s, failed);
        if (result != RUN_OK) return result;
        *status = call_access(a + i, instance);
        if (failed_call(*status)) return RUN_SET;
    }
    return RUN_OK;
}

SHARED int get_typed(const access_t *a, int64_t n, void *instance, double *s, int *status, int32_t *failed)
{
    for (int64_t i = 0; i < n; i++) {
        int result;
        *status = call_access(a + i, instance);
        if (failed_call(*status)) return RUN_GET;
        result = convert_out(a + i, s, failed);
        if (result != RUN_OK) return result;
    }
    return RUN_OK;
}
