/* typed.h: one step of an FMU with other types than float64, with event mode, clocks or early return.
 *
 * Part of engine.c, which has the structs. One call moves all variables of one FMI type, by way of a
 * buffer of that type. Whole numbers are carried by doubles: exactly, or not at all.
 */

#define EXACT 9007199254740992.0 /* 2^53: whole numbers up to here are doubles */
#define SLACK 1e-9               /* of a step: two times closer than this are one */
enum { CALLS_AT_MOST = 100000 }; /* without getting anywhere, within one step */

/* Whole numbers within [low, high] only: nothing is rounded silently. */
#define PUT(T, low, high)                                                     \
    for (int64_t i = 0; i < a->count; i++) {                                  \
        const double x = s[a->places[i]];                                     \
        if (!(x >= (low) && x <= (high)) || (double)(T)x != x) {              \
            *failed = (int32_t)a->places[i];                                  \
            return RUN_VALUE;                                                 \
        }                                                                     \
        ((T *)a->buffer)[i] = (T)x;                                           \
    }                                                                         \
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

#define GET(T)                                                                           \
    for (int64_t i = 0; i < a->count; i++) s[a->places[i]] = (double)((T *)a->buffer)[i]; \
    break
#define GET_EXACT(T)                                                                     \
    for (int64_t i = 0; i < a->count; i++) {                                             \
        const T x = ((T *)a->buffer)[i];                                                 \
        s[a->places[i]] = (double)x;                                                     \
        if (x > (T)EXACT || (double)x < -EXACT) {                                        \
            *failed = (int32_t)a->places[i];                                             \
            return RUN_VALUE;                                                            \
        }                                                                                \
    }                                                                                    \
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
        for (int64_t i = 0; i < a->count; i++)
            s[a->places[i]] = ((unsigned char *)a->buffer)[i] != 0;
    }
    return RUN_OK;
}

static int call_access(const access_t *a, void *instance)
{
    const size_t n = (size_t)a->n_references;
    if (a->fmi == 2) return ((access2_t)a->call)(instance, a->references, n, a->buffer);
    return ((access3_t)a->call)(instance, a->references, n, a->buffer, (size_t)a->count);
}

static int set_typed(const access_t *a, int64_t n, void *instance, const double *s, int *status,
                     int32_t *failed)
{
    for (int64_t i = 0; i < n; i++) {
        const int result = convert_in(a + i, s, failed);
        if (result != RUN_OK) return result;
        *status = call_access(a + i, instance);
        if (*status > 1) return RUN_SET;
    }
    return RUN_OK;
}

static int get_typed(const access_t *a, int64_t n, void *instance, double *s, int *status,
                     int32_t *failed)
{
    for (int64_t i = 0; i < n; i++) {
        int result;
        *status = call_access(a + i, instance);
        if (*status > 1) return RUN_GET;
        result = convert_out(a + i, s, failed);
        if (result != RUN_OK) return result;
    }
    return RUN_OK;
}

/* fmi3UpdateDiscreteStates until nothing changes, then Step Mode (FMI 3.0.2, 2.3.5). */
static int leave_event_mode(typed_t *x, void *instance, int *status)
{
    _Bool again = 1, terminate = 0, nominals, values, defined = 0;
    double next = 0.0;

    for (int i = 0; again && !terminate; i++) {
        if (i == CALLS_AT_MOST) return RUN_STUCK;
        again = 0;
        *status = ((update_t)x->update)(instance, &again, &terminate, &nominals, &values,
                                        &defined, &next);
        if (*status > 1) return RUN_EVENT;
    }
    x->next_event = defined ? next : DBL_MAX;
    if (terminate) return RUN_TERMINATED;
    *status = ((mode_t3)x->enter_step)(instance);
    return *status > 1 ? RUN_EVENT : RUN_OK;
}

static int enter_event_mode(const typed_t *x, void *instance, int *status)
{
    *status = ((mode_t3)x->enter_event)(instance);
    return *status > 1 ? RUN_EVENT : RUN_OK;
}

static int changed(const access_t *a, int64_t n, const double *s)
{
    int different = 0;
    for (; n > 0; n--, a++)
        for (int64_t i = 0; i < a->count; i++)
            if (s[a->places[i]] != a->held[i]) {
                a->held[i] = s[a->places[i]];
                different = 1;
            }
    return different;
}

static int due(const ticker_t *c, int64_t hit)
{
    return hit >= c->shift && (hit - c->shift) % c->period == 0;
}

/* One event at the start of step `hit`: discrete inputs that changed, and all clocks due. */
static int input_event(const unit_t *u, double *s, int64_t hit, int *status, int32_t *failed)
{
    static const _Bool active = 1;
    typed_t *x = u->typed;
    int result, needed = changed(x->discrete, x->n_discrete, s), ticks = 0;

    for (int64_t i = 0; i < x->n_clocks; i++) ticks |= due(x->clocks + i, hit);
    if (!needed && !ticks) return RUN_OK;
    result = enter_event_mode(x, u->instance, status);
    for (int64_t i = 0; i < x->n_clocks && result == RUN_OK; i++) {
        if (!due(x->clocks + i, hit)) continue;
        *status = ((clock_t3)x->set_clock)(u->instance, &x->clocks[i].reference, 1, &active);
        if (*status > 1) return RUN_EVENT;
    }
    if (result == RUN_OK && needed)
        result = set_typed(x->discrete, x->n_discrete, u->instance, s, status, failed);
    if (result == RUN_OK && ticks)
        result = set_typed(x->clocked, x->n_clocked, u->instance, s, status, failed);
    return result == RUN_OK ? leave_event_mode(x, u->instance, status) : result;
}

/* doStep until t + h: the FMU may return early, and is stopped at the time events it announced. */
static int advance(const unit_t *u, double t, int *status)
{
    typed_t *x = u->typed;
    const double end = t + u->h, slack = SLACK * u->h;
    double now = t;

    for (int calls = 0; calls < CALLS_AT_MOST; calls++) {
        _Bool event = 0, terminate = 0, early = 0;
        double length = calls ? end - now : u->h, reached = now + length;
        int cut = x->variable && x->next_event < end - slack && x->next_event > now + slack;
        if (cut) length = x->next_event - now;
        *status = ((step3_t)u->step)(u->instance, now, length, 1, &event, &terminate, &early,
                                     &reached);
        if (*status > 1) return RUN_STEP;
        if (terminate) return RUN_TERMINATED;
        now = early ? reached : cut ? x->next_event : end;
        if (x->update && (event || x->next_event <= now + slack)) {
            int result = enter_event_mode(x, u->instance, status);
            if (result == RUN_OK) result = leave_event_mode(x, u->instance, status);
            if (result != RUN_OK) return result;
        }
        if (now >= end - slack) return RUN_OK;
    }
    return RUN_STUCK;
}

#if defined(__GNUC__)
__attribute__((noinline)) /* the common steps stay as they are without it */
#endif
static int step_typed(const unit_t *u, double *s, double t, int64_t hit, int *status,
                      int32_t *failed)
{
    const typed_t *x = u->typed;
    int end = RUN_OK;
    int result = set_typed(x->inputs, x->n_inputs, u->instance, s, status, failed);
    if (result == RUN_OK && x->update) result = input_event(u, s, hit, status, failed);
    if (result != RUN_OK) return result;
    if (x->fmi == 2) {
        *status = ((step2_t)u->step)(u->instance, t, u->h, 1);
        if (*status > 1) return RUN_STEP;
    } else {
        end = advance(u, t, status);
        if (end != RUN_OK && end != RUN_TERMINATED) return end;
    }
    result = get_typed(x->outputs, x->n_outputs, u->instance, s, status, failed);
    return result != RUN_OK ? result : end;
}
