/* An FMU of FMI 1.0 for co-simulation (fmiFunctions.h 1.0), which insists on its order of calls: a lag
 * x' = (gain u - x), solved exactly for a held u, and an input and an output of each type. With `how` 1,
 * fmiDoStep from `when` on returns an error, with 2 a fatal one, with 3 discard.
 */
#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define FMI __attribute__((visibility("default")))
#define F(name) FMI old1_fmi##name
typedef void (*log_t)(void *, const char *, int, const char *, const char *, ...);
typedef struct {
    log_t log;
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*finished)(void *, int);
} callbacks_t;
enum { U, GAIN, WHEN, X, Y, HOW = 10, COUNT, MODE, COUNTED, FLAG = 20, UP, LABEL = 30, SAID };
enum { MADE, STARTED, BROKEN, DEAD, OVER };

typedef struct {
    callbacks_t f;
    char name[64], label[64], said[80];
    double real[5];
    int whole[4], state, flag;
} fmu_t;

static int refuse(fmu_t *m, const char *why, unsigned reference)
{
    m->f.log(m, m->name, 3, "error", "%s (%u)", why, reference);
    return 3;
}

FMI const char *old1_fmiGetTypesPlatform(void) { return "standard32"; }
FMI const char *old1_fmiGetVersion(void) { return "1.0"; }
FMI int old1_fmiSetDebugLogging(void *m, char on)
{
    (void)m, (void)on;
    return 0;
}

FMI void *old1_fmiInstantiateSlave(const char *name, const char *guid, const char *location, const char *mime,
                                   double timeout, char visible, char interactive, callbacks_t f,
                                   char logging)
{
    fmu_t *m;
    (void)timeout, (void)visible, (void)interactive;
    if (strcmp(guid, "{old}") || strncmp(location, "file:", 5) || strncmp(mime, "application/x-fmu", 17)) {
        f.log(NULL, name, 3, "error", "the token is '%s'", guid);
        return NULL;
    }
    m = f.allocate(1, sizeof *m);
    m->f = f;
    snprintf(m->name, sizeof m->name, "%s", name);
    m->real[GAIN] = 2.0, m->real[WHEN] = 1e9, m->real[X] = 1.0;
    strcpy(m->label, "nothing");
    if (logging) f.log(m, name, 0, "log", "%s is made, %d", name, 1);
    return m;
}
FMI int old1_fmiInitializeSlave(fmu_t *m, double start, char stop_defined, double stop)
{
    (void)start, (void)stop_defined, (void)stop;
    if (m->state != MADE) return refuse(m, "initialized twice", 0);
    m->state = STARTED;
    m->real[Y] = m->real[X];
    return 0;
}
FMI int old1_fmiTerminateSlave(fmu_t *m)
{
    if (m->state != STARTED) return refuse(m, "terminated too early", 0);
    m->state = OVER;
    return 0;
}
FMI int old1_fmiResetSlave(fmu_t *m)
{
    m->state = MADE;
    return 0;
}
FMI void old1_fmiFreeSlaveInstance(fmu_t *m)
{
    if (m->state != DEAD) m->f.release(m);
}
FMI int old1_fmiDoStep(fmu_t *m, double t, double h, char fresh)
{
    const double decay = exp(-h);
    if (m->state != STARTED || fresh != 1) return refuse(m, "no step now", 0);
    if (m->whole[HOW - HOW] && t >= m->real[WHEN]) {
        const int how = m->whole[0];
        m->state = how == 2 ? DEAD : how == 3 ? STARTED : BROKEN;
        m->f.log(m, m->name, 3, "error", "no step from %g on", t);
        return how == 1 ? 3 : how == 2 ? 4 : 2;
    }
    m->real[X] = m->real[GAIN] * m->real[U] * (1.0 - decay) + m->real[X] * decay;
    m->real[Y] = m->real[X];
    m->whole[COUNTED - HOW] = m->whole[COUNT - HOW] + 10 * m->whole[MODE - HOW];
    snprintf(m->said, sizeof m->said, "%s at %g", m->label, t + h);
    return 0;
}
FMI int old1_fmiCancelStep(void *m)
{
    (void)m;
    return 3;
}
FMI int old1_fmiGetStatus(void *m, int kind, int *v)
{
    (void)m, (void)kind, (void)v;
    return 2;
}
FMI int old1_fmiGetRealStatus(void *m, int k, double *v)
{
    (void)m, (void)k, (void)v;
    return 2;
}
FMI int old1_fmiGetIntegerStatus(void *m, int k, int *v)
{
    (void)m, (void)k, (void)v;
    return 2;
}
FMI int old1_fmiGetBooleanStatus(void *m, int k, char *v)
{
    (void)m, (void)k, (void)v;
    return 2;
}
FMI int old1_fmiGetStringStatus(void *m, int k, const char **v)
{
    (void)m, (void)k, (void)v;
    return 2;
}
FMI int old1_fmiSetRealInputDerivatives(void *m, const unsigned *r, size_t n, const int *o, const double *v)
{
    (void)m, (void)r, (void)n, (void)o, (void)v;
    return 3;
}
FMI int old1_fmiGetRealOutputDerivatives(void *m, const unsigned *r, size_t n, const int *o, double *v)
{
    (void)m, (void)r, (void)n, (void)o, (void)v;
    return 3;
}

static int closed(fmu_t *m, unsigned r)
{
    const int input = r == U || r == COUNT || r == MODE || r == FLAG;
    return m->state != MADE && !(m->state == STARTED && input);
}
FMI int old1_fmiSetReal(fmu_t *m, const unsigned *r, size_t n, const double *v)
{
    for (size_t i = 0; i < n; i++) {
        if (closed(m, r[i]) || r[i] > X) return refuse(m, "set too late", r[i]);
        m->real[r[i]] = v[i];
    }
    return 0;
}
FMI int old1_fmiSetInteger(fmu_t *m, const unsigned *r, size_t n, const int *v)
{
    for (size_t i = 0; i < n; i++) {
        if (closed(m, r[i])) return refuse(m, "set too late", r[i]);
        m->whole[r[i] - HOW] = v[i];
    }
    return 0;
}
FMI int old1_fmiSetBoolean(fmu_t *m, const unsigned *r, size_t n, const char *v)
{
    for (size_t i = 0; i < n; i++) {
        if (closed(m, r[i]) || (v[i] != 0 && v[i] != 1)) return refuse(m, "no Boolean", r[i]);
        m->flag = v[i];
    }
    return 0;
}
FMI int old1_fmiSetString(fmu_t *m, const unsigned *r, size_t n, const char *const *v)
{
    for (size_t i = 0; i < n; i++) {
        if (closed(m, r[i])) return refuse(m, "set too late", r[i]);
        snprintf(m->label, sizeof m->label, "%s", v[i]);
    }
    return 0;
}
FMI int old1_fmiGetReal(fmu_t *m, const unsigned *r, size_t n, double *v)
{
    if (m->state == MADE) return refuse(m, "got before the start", r[0]);
    for (size_t i = 0; i < n; i++) v[i] = m->real[r[i]];
    return 0;
}
FMI int old1_fmiGetInteger(fmu_t *m, const unsigned *r, size_t n, int *v)
{
    for (size_t i = 0; i < n; i++) v[i] = m->whole[r[i] - HOW];
    return 0;
}
FMI int old1_fmiGetBoolean(fmu_t *m, const unsigned *r, size_t n, char *v)
{
    for (size_t i = 0; i < n; i++) v[i] = (char)(r[i] == UP ? !m->flag : m->flag);
    return 0;
}
FMI int old1_fmiGetString(fmu_t *m, const unsigned *r, size_t n, const char **v)
{
    for (size_t i = 0; i < n; i++) v[i] = r[i] == LABEL ? m->label : m->said;
    return 0;
}
