/* An FMU of FMI 3.0 that gives back what it gets, in every type; sizes and names may be set. */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define FMI __attribute__((visibility("default")))
typedef void (*log_t)(void *, int, const char *, const char *);
enum {
    SIZE = 300,
    MATRIX_IN,
    MATRIX_OUT,
    FACTOR,
    MODE,
    FLIP,
    LABEL_IN = 120,
    BLOB_IN,
    LABEL_OUT = 220,
    BLOB_OUT,
    MOST = 8
};

typedef struct {
    log_t log;
    void *environment;
    bool configuring, flip;
    double values[12], given[12], factor, matrix[MOST * MOST], output[MOST * MOST];
    int64_t exact, exact_given, mode;
    uint64_t size;
    char label[64];
    uint8_t blob[64];
    size_t blob_size;
} fmu_t;

static int refuse(fmu_t *x, const char *what, uint32_t reference, size_t n)
{
    char text[200];
    snprintf(text, sizeof text, "%s: %zu values do not fit variable %u", what, n, (unsigned)reference);
    x->log(x->environment, 3, "logStatusError", text);
    return 3;
}

FMI void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources,
                                      bool visible, bool logging, bool events, bool early,
                                      const uint32_t *required, size_t n, void *environment, log_t log,
                                      void *update)
{
    fmu_t *x = calloc(1, sizeof *x);
    (void)name, (void)token, (void)resources, (void)visible, (void)events, (void)early;
    (void)required, (void)n, (void)update;
    x->log = log, x->environment = environment, x->size = 2, x->factor = 1.0;
    strcpy(x->label, "nothing");
    if (logging) log(environment, 0, "logAll", "made with logging on");
    return x;
}
FMI void fmi3FreeInstance(void *x) { free(x); }
FMI int fmi3Terminate(void *x)
{
    (void)x;
    return 0;
}
FMI int fmi3EnterConfigurationMode(fmu_t *x)
{
    x->configuring = true;
    return 0;
}
FMI int fmi3ExitConfigurationMode(fmu_t *x)
{
    x->configuring = false;
    return 0;
}
FMI int fmi3EnterInitializationMode(void *x, bool a, double b, double c, bool d, double e)
{
    (void)x, (void)a, (void)b, (void)c, (void)d, (void)e;
    return 0;
}
FMI int fmi3ExitInitializationMode(void *x)
{
    (void)x;
    return 0;
}
FMI int fmi3DoStep(fmu_t *x, double t, double h, bool prior, bool *event, bool *terminate, bool *early,
                   double *last)
{
    (void)prior;
    memcpy(x->given, x->values, sizeof x->values);
    x->exact_given = x->exact;
    for (uint64_t i = 0; i < x->size * x->size; i++)
        x->output[i] = (x->flip ? -1.0 : 1.0) * x->factor * x->matrix[i];
    *event = *terminate = *early = false;
    *last = t + h;
    return 0;
}

/* Variables 100 + i go in, 200 + i come out: i is the type. */
#define TYPE(NAME, T, INDEX)                                                           \
    FMI int fmi3Set##NAME(fmu_t *x, const uint32_t *r, size_t n, const T *v, size_t m) \
    {                                                                                  \
        if (n != m) return refuse(x, "fmi3Set" #NAME, n ? *r : 0, m);                  \
        for (size_t i = 0; i < n; i++)                                                 \
            if (r[i] == 100 + INDEX) x->values[INDEX] = (double)v[i];                  \
            else return refuse(x, "fmi3Set" #NAME, r[i], m);                           \
        return 0;                                                                      \
    }                                                                                  \
    FMI int fmi3Get##NAME(fmu_t *x, const uint32_t *r, size_t n, T *v, size_t m)       \
    {                                                                                  \
        if (n != m) return refuse(x, "fmi3Get" #NAME, n ? *r : 0, m);                  \
        for (size_t i = 0; i < n; i++) v[i] = (T)x->given[r[i] - 200];                 \
        return 0;                                                                      \
    }
TYPE(Float32, float, 1)
TYPE(Int8, int8_t, 2)
TYPE(UInt8, uint8_t, 3)
TYPE(Int16, int16_t, 4)
TYPE(UInt16, uint16_t, 5)
TYPE(Int32, int32_t, 6)
TYPE(UInt32, uint32_t, 7)

FMI int fmi3SetBoolean(fmu_t *x, const uint32_t *r, size_t n, const bool *v, size_t m)
{
    for (size_t i = 0; i < n; i++)
        if (r[i] != FLIP) x->values[11] = v[i];
        else if (!x->configuring) return refuse(x, "fmi3SetBoolean", r[i], m);
        else x->flip = v[i];
    return 0;
}
FMI int fmi3GetBoolean(fmu_t *x, const uint32_t *r, size_t n, bool *v, size_t m)
{
    (void)m;
    for (size_t i = 0; i < n; i++) v[i] = r[i] == FLIP ? x->flip : x->given[11] != 0.0;
    return 0;
}

FMI int fmi3SetInt64(fmu_t *x, const uint32_t *r, size_t n, const int64_t *v, size_t m)
{
    (void)m;
    for (size_t i = 0; i < n; i++)
        if (r[i] == MODE) x->mode = v[i];
        else if (r[i] == 110) x->values[10] = (double)v[i];
        else x->exact = v[i];
    return 0;
}
FMI int fmi3GetInt64(fmu_t *x, const uint32_t *r, size_t n, int64_t *v, size_t m)
{
    (void)m; /* mode 3 ("too much") gives more than a double holds */
    for (size_t i = 0; i < n; i++)
        if (r[i] == MODE) v[i] = x->mode;
        else if (r[i] == 210) v[i] = (int64_t)x->given[10];
        else v[i] = x->mode == 3 ? x->exact_given + 9007199254740993 : x->exact_given;
    return 0;
}
FMI int fmi3SetUInt64(fmu_t *x, const uint32_t *r, size_t n, const uint64_t *v, size_t m)
{
    for (size_t i = 0; i < n; i++)
        if (r[i] != SIZE) x->values[9] = (double)v[i];
        else if (!x->configuring || v[i] > MOST) return refuse(x, "fmi3SetUInt64", r[i], m);
        else x->size = v[i];
    return 0;
}
FMI int fmi3GetUInt64(fmu_t *x, const uint32_t *r, size_t n, uint64_t *v, size_t m)
{
    (void)m;
    for (size_t i = 0; i < n; i++) v[i] = r[i] == SIZE ? x->size : (uint64_t)x->given[r[i] - 200];
    return 0;
}
FMI int fmi3SetFloat64(fmu_t *x, const uint32_t *r, size_t n, const double *v, size_t m)
{
    const size_t all = (size_t)(x->size * x->size);
    size_t used = 0;
    for (size_t i = 0; i < n; i++)
        if (r[i] == MATRIX_IN) {
            if (m < used + all) return refuse(x, "fmi3SetFloat64", r[i], m);
            memcpy(x->matrix, v + used, all * sizeof *v);
            used += all;
        } else if (r[i] == FACTOR) x->factor = v[used++];
        else x->values[0] = v[used++];
    return used == m ? 0 : refuse(x, "fmi3SetFloat64", n ? *r : 0, m);
}
FMI int fmi3GetFloat64(fmu_t *x, const uint32_t *r, size_t n, double *v, size_t m)
{
    const size_t all = (size_t)(x->size * x->size);
    size_t used = 0;
    for (size_t i = 0; i < n; i++)
        if (r[i] == MATRIX_OUT) {
            if (m < used + all) return refuse(x, "fmi3GetFloat64", r[i], m);
            memcpy(v + used, x->output, all * sizeof *v);
            used += all;
        } else v[used++] = r[i] == FACTOR ? x->factor : x->given[0];
    return used == m ? 0 : refuse(x, "fmi3GetFloat64", n ? *r : 0, m);
}
FMI int fmi3SetString(fmu_t *x, const uint32_t *r, size_t n, const char *const *v, size_t m)
{
    if (n != 1 || m != 1 || *r != LABEL_IN) return refuse(x, "fmi3SetString", n ? *r : 0, m);
    snprintf(x->label, sizeof x->label, "%s", *v);
    return 0;
}
FMI int fmi3GetString(fmu_t *x, const uint32_t *r, size_t n, const char **v, size_t m)
{
    (void)r, (void)n, (void)m;
    *v = x->label;
    return 0;
}
FMI int fmi3SetBinary(fmu_t *x, const uint32_t *r, size_t n, const size_t *sizes, const uint8_t *const *v,
                      size_t m)
{
    (void)r, (void)n, (void)m;
    memcpy(x->blob, *v, x->blob_size = sizes[0]);
    return 0;
}
FMI int fmi3GetBinary(fmu_t *x, const uint32_t *r, size_t n, size_t *sizes, const uint8_t **v, size_t m)
{
    (void)r, (void)n, (void)m;
    *sizes = x->blob_size, *v = x->blob;
    return 0;
}
