/* Functions of FMI 3.0 that save and restore a fmu_t from `first` on, its first member that is no address. */
#include <string.h>

#define SAVED_FROM(first)                                                                   \
    enum { SAVED = sizeof(fmu_t) - offsetof(fmu_t, first) };                                \
    FMI int fmi3GetFMUState(fmu_t *x, void **state)                                         \
    {                                                                                       \
        if (!*state) *state = malloc(SAVED);                                                \
        memcpy(*state, (char *)x + sizeof *x - SAVED, SAVED);                               \
        return 0;                                                                           \
    }                                                                                       \
    FMI int fmi3SetFMUState(fmu_t *x, const void *state)                                    \
    {                                                                                       \
        memcpy((char *)x + sizeof *x - SAVED, state, SAVED);                                \
        return 0;                                                                           \
    }                                                                                       \
    FMI int fmi3FreeFMUState(fmu_t *x, void **state)                                        \
    {                                                                                       \
        (void)x;                                                                            \
        free(*state);                                                                       \
        *state = NULL;                                                                      \
        return 0;                                                                           \
    }                                                                                       \
    FMI int fmi3SerializedFMUStateSize(fmu_t *x, const void *state, size_t *size)           \
    {                                                                                       \
        (void)x, (void)state;                                                               \
        *size = SAVED;                                                                      \
        return 0;                                                                           \
    }                                                                                       \
    FMI int fmi3SerializeFMUState(fmu_t *x, const void *state, char *bytes, size_t size)    \
    {                                                                                       \
        (void)x;                                                                            \
        memcpy(bytes, state, size);                                                         \
        return 0;                                                                           \
    }                                                                                       \
    FMI int fmi3DeserializeFMUState(fmu_t *x, const char *bytes, size_t size, void **state) \
    {                                                                                       \
        (void)x;                                                                            \
        *state = malloc(size);                                                              \
        memcpy(*state, bytes, size);                                                        \
        return 0;                                                                           \
    }
