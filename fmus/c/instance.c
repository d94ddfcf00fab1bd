/* instance.c - life cycle and logging of an instance. */
#include "instance.h"

#include <float.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { TEXT_SIZE = 512 };

static const struct {
    unsigned bit;
    const char *name;
} CATEGORIES[] = {{LOG_EVENTS, "logEvents"},
                  {LOG_WARNING, "logStatusWarning"},
                  {LOG_DISCARD, "logStatusDiscard"},
                  {LOG_ERROR, "logStatusError"},
                  {LOG_ALL, "logAll"}};
enum { N_CATEGORIES = sizeof CATEGORIES / sizeof CATEGORIES[0] };

static const struct {
    unsigned bit;
    const char *name;
} MODES[] = {{INSTANTIATED, "Instantiated"},
             {INITIALIZATION, "Initialization Mode"},
             {STEPPING, "Step Mode"},
             {STEP_FAILED, "Step Failed"},
             {TERMINATED, "Terminated"},
             {EVENT, "Event Mode"},
             {CONFIGURATION, "Configuration Mode"},
             {CONTINUOUS, "Continuous-Time Mode"}};
enum { N_MODES = sizeof MODES / sizeof MODES[0] };

/* --- logging ------------------------------------------------------------------------------ */

static const char *category_name(unsigned category)
{
    for (int i = 0; i < N_CATEGORIES; i++)
        if (CATEGORIES[i].bit == category) return CATEGORIES[i].name;
    return "logAll";
}

/* "function: sentence" to the importer, if it listens. */
static void tell(const Instance *x, Status status, unsigned category, const char *function,
                 const char *format, va_list arguments)
{
    char text[TEXT_SIZE];
    if (x->callback == NULL) return;
    const int used = snprintf(text, sizeof text, "%s: ", function);
    if (used < 0 || used >= TEXT_SIZE) return;
    vsnprintf(text + used, sizeof text - (size_t)used, format, arguments);
    x->forward(x, status, category_name(category), text);
}

Status refuse(const Instance *x, const char *function, const char *format, ...)
{
    va_list arguments;
    if (x == NULL) return STATUS_ERROR;
    va_start(arguments, format);
    tell(x, STATUS_ERROR, LOG_ERROR, function, format, arguments);
    va_end(arguments);
    return STATUS_ERROR;
}

Status discard(const Instance *x, const char *function, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    tell(x, STATUS_DISCARD, LOG_DISCARD, function, format, arguments);
    va_end(arguments);
    return STATUS_DISCARD;
}

static void note(const Instance *x, const char *function, const char *format, ...)
{
    va_list arguments;
    if (!(x->categories & LOG_EVENTS)) return;
    va_start(arguments, format);
    tell(x, STATUS_OK, LOG_EVENTS, function, format, arguments);
    va_end(arguments);
}

static const char *mode_name(unsigned mode)
{
    for (int i = 0; i < N_MODES; i++)
        if (MODES[i].bit == mode) return MODES[i].name;
    return "an unknown mode";
}

int refuse_mode(const Instance *x, unsigned allowed, const char *function)
{
    char names[160] = "";
    if (x == NULL) return 0;
    if (!declared.is_clocked && declared.rates == NULL) allowed &= ~(unsigned)EVENT;
    if (declared.rates == NULL) allowed &= ~(unsigned)CONTINUOUS;
    if (declared.rates != NULL) allowed &= ~(unsigned)(STEPPING | STEP_FAILED);
    if (declared.structural == declared.n_scalars) allowed &= ~(unsigned)CONFIGURATION;
    for (int i = 0; i < N_MODES; i++)
        if (MODES[i].bit & allowed) {
            if (names[0]) strcat(names, ", ");
            strcat(names, MODES[i].name);
        }
    refuse(x, function, "not allowed in %s, expected: %s", mode_name(x->mode),
           names[0] ? names : "never, this FMU has no such mode");
    return 0;
}

Status refuse_access(const Instance *x, const char *function, const char *name, const char *type,
                     unsigned access, unsigned need)
{
    if (!(access & need & (IS_REAL | IS_INTEGER | IS_BOOLEAN | IS_SIZE)))
        return refuse(x, function, "%s is of type %s", name, type);
    if (access & IS_SIZE)
        return refuse(x, function, "%s is a structural parameter, to be set in Configuration Mode", name);
    if (access & IS_PARAMETER)
        return refuse(x, function, "%s is a fixed parameter, not to be set after initialization", name);
    if (access & SET_AT_START)
        return refuse(x, function, "%s has a start value only, not to be set after initialization", name);
    return refuse(x, function, "%s is calculated, it cannot be set", name);
}

Status set_logging(Instance *x, int on, size_t n, const char *const categories[], const char *function)
{
    unsigned bits = n == 0 ? LOG_ALL : 0;
    if (n > 0 && categories == NULL)
        return refuse(x, function, "categories is null, expected %lu names", (unsigned long)n);
    for (size_t i = 0; i < n; i++) {
        int k = 0;
        while (k < N_CATEGORIES && (categories[i] == NULL || strcmp(categories[i], CATEGORIES[k].name) != 0))
            k++;
        if (k == N_CATEGORIES)
            return refuse(x, function, "unknown log category '%.80s'",
                          categories[i] == NULL ? "(null)" : categories[i]);
        bits |= CATEGORIES[k].bit;
    }
    x->categories = on ? x->categories | bits : x->categories & ~bits;
    return STATUS_OK;
}

/* --- life cycle --------------------------------------------------------------------------- */

static void go_to_start(Instance *x)
{
    memcpy(x->values, start_values, declared.n_scalars * sizeof *x->values);
    x->values[TIME] = 0.0;
    x->start_time = 0.0;
    x->stop_time = INFINITY;
    x->stale = 1;
    x->clock.active = 0;
    x->clock.count = 0.0;
    x->mode = INSTANTIATED;
}

/* Memory for an instance and its values, those before a tick at the end; NULL without memory. */
static Instance *allocated(void)
{
    const size_t values = declared.is_clocked ? 2 * (size_t)N_STORED : N_STORED;
    Instance *x = calloc(1, sizeof *x + values * sizeof *x->values);
    if (x != NULL && declared.is_clocked) x->clock.before = x->values + N_STORED;
    return x;
}

Instance *instance_new(const char *name, const char *token, int logging, Forward *forward,
                       AnyFunction *callback, void *environment, const char *function)
{
    Instance first = {0}; /* to log with until there is one */
    first.name = (char *)(name == NULL ? "" : name);
    first.forward = forward;
    first.callback = callback;
    first.environment = environment;
    first.categories = logging ? LOG_ALL : 0;
    if (name == NULL || name[0] == '\0') {
        refuse(&first, function, "the instance name is %s", name == NULL ? "null" : "empty");
        return NULL;
    }
    if (token == NULL || strcmp(token, declared.token) != 0) {
        refuse(&first, function, "the token is '%.80s', expected '%s' of the model description",
               token == NULL ? "(null)" : token, declared.token);
        return NULL;
    }
    Instance *x = allocated();
    char *copy = malloc(strlen(name) + 1);
    if (x == NULL || copy == NULL) {
        refuse(&first, function, "no memory for an instance of %s", declared.identifier);
        free(x);
        free(copy);
        return NULL;
    }
    const Clock clock = x->clock;
    *x = first;
    x->clock = clock;
    x->name = strcpy(copy, name);
    go_to_start(x);
    note(x, function, "%s instantiated", declared.identifier);
    return x;
}

void instance_free(Instance *x)
{
    if (x == NULL) return;
    free(x->name);
    free(x);
}

Status set_up(Instance *x, double start, int stop_defined, double stop, const char *function)
{
    if (!(fabs(start) <= DBL_MAX))
        return refuse(x, function, "the start time is %g s, expected a finite number", start);
    if (stop_defined && !(stop >= start))
        return refuse(x, function, "the stop time is %g s, expected at least the start time %g s", stop,
                      start);
    x->start_time = x->values[TIME] = start;
    x->stop_time = stop_defined ? stop : INFINITY;
    return STATUS_OK;
}

Status enter_initialization(Instance *x)
{
    x->mode = INITIALIZATION;
    x->stale = 1;
    return STATUS_OK;
}

/* Start values, parameters and inputs are finite, and parameters in their range. */
static Status check_start(const Instance *x, const char *function)
{
    for (unsigned i = 0; i < declared.n_variables; i++) {
        const Variable *v = &variables[i];
        if (!(v->access & SET_AT_START)) continue;
        for (unsigned k = v->offset; k < v->offset + size_of(x, v); k++) {
            const double value = x->values[k];
            if (!all_finite(&value, 1))
                return refuse(x, function, "%s is %g, expected a finite number", scalar_names[k], value);
            if ((v->access & IS_PARAMETER) && !(value >= v->minimum && value <= v->maximum))
                return refuse(x, function, "%s is %g, expected between %g and %g", scalar_names[k], value,
                              v->minimum, v->maximum);
        }
    }
    return STATUS_OK;
}

Status settle(Instance *x, const char *function)
{
    if (!x->stale) return STATUS_OK;
    if (declared.rates != NULL && (x->mode & (EVENT | CONTINUOUS | TERMINATED))) {
        const Status inputs = check_inputs(x, x->values[TIME], function);
        const char *problem = inputs == STATUS_OK ? declared.rates((Model *)x->values) : NULL;
        if (problem != NULL) return discard(x, function, "at t = %g s %s", x->values[TIME], problem);
        x->stale = inputs != STATUS_OK;
        return inputs;
    }
    if (check_start(x, function) != STATUS_OK) return STATUS_ERROR;
    const char *why = model_initial((Model *)x->values);
    if (why == NULL && declared.rates != NULL) why = declared.rates((Model *)x->values);
    if (why != NULL) return refuse(x, function, "%s cannot start: %s", declared.identifier, why);
    x->stale = 0;
    return STATUS_OK;
}

Status exit_initialization(Instance *x, const char *function)
{
    if (settle(x, function) != STATUS_OK) return STATUS_ERROR;
    x->mode = x->clock.used || declared.rates != NULL ? EVENT : STEPPING;
    note(x, function, "%s initialised at t = %g s", declared.identifier, x->values[TIME]);
    return STATUS_OK;
}

Status terminate(Instance *x)
{
    x->mode = TERMINATED;
    return STATUS_OK;
}

Status reset(Instance *x)
{
    go_to_start(x);
    return STATUS_OK;
}

Status check_inputs(const Instance *x, double t, const char *function)
{
    const unsigned bad = find_not_finite(x->values);
    if (bad == TIME) return STATUS_OK;
    return discard(x, function, "input %s is %g at t = %g s, expected a finite number", scalar_names[bad],
                   x->values[bad], t);
}
