/* An instance of the model between an importer's calls: what both versions share.
 *
 * Samples are counted, so that time is start + samples * UPPER_SAMPLE_TIME whatever an
 * importer adds up. Sample n is due at its time. While an instance starts, and in event
 * mode, its values are the sample that is due, computed with the inputs as they are
 * set; a step takes the sample, with these inputs, and those behind it that it spans,
 * with the same; then its values are the last sample that was taken. */

enum { CREATED, STARTING, EVENT, STEPPING, ENDED };

typedef struct {
    double start_time;
    double stop_time;
    int64_t samples;
    int stops;
    int phase;
    int kind;
    int fresh; /* whether `next` and `now` belong to the sample that is due */
    int due; /* whether `now` is a sample that has not been taken */
    int rests;
    double u[FMI_AT_REPORTED]; /* inputs; of one that learns measured outputs too */
    double lag[LAGS + 1];
    double total[TOTALS + 1]; /* sums over time, before the sample that is due */
    memory past; /* before the sample that is due */
    memory next; /* behind it */
    NAME_out now;
} unit;

typedef struct {
    char token[sizeof(TOKEN)];
    unit m;
} kept_unit;

static void fmi_unit_reset(unit *m)
{
    memset(m, 0, sizeof(*m));
    m->kind = UPPER_STEADY;
    m->rests = 1;
    memcpy(m->u, fmi_input_starts, sizeof(m->u));
    memcpy(m->lag, fmi_lag_starts, sizeof(m->lag));
}

static void fmi_unit_inputs(const unit *m, NAME_real *u)
{
    size_t k;
    for (k = 0; k < UPPER_INPUTS; k++) {
        u[k] = (NAME_real)m->u[k];
    }
}

/* Given values are a row of lags for every input, then for every output, the newest
 * first; the model wants samples, the oldest first. */
static void fmi_unit_start(unit *m, const NAME_real *now)
{
    NAME_real u[UPPER_INPUTS];
    NAME_real y[UPPER_COMPUTED];
    size_t t;
    size_t k;
    memset(y, 0, sizeof(y));
    NAME_state begun;
    memset(&begun, 0, sizeof(begun));
    if (m->kind != UPPER_GIVEN || LAGS == 0) {
        /* without a past the first inputs are all there is */
        m->rests = NAME_start(&begun, m->kind, now, y) != 1;
        begin_memory(&m->past, &begun);
        return;
    }
    for (t = ROWS; t > 0; t--) {
        for (k = 0; k < UPPER_INPUTS; k++) {
            u[k] = (NAME_real)m->lag[k * ROWS + t - 1];
        }
        for (k = 0; k < UPPER_COMPUTED; k++) {
            y[k] = (NAME_real)m->lag[(UPPER_INPUTS + k) * ROWS + t - 1];
        }
        if (t == ROWS) {
            (void)NAME_start(&begun, m->kind, u, y);
        }
        NAME_observe(&begun, u, y);
    }
    begin_memory(&m->past, &begun);
}

/* The sample that is due, with the inputs as they are set. */
static void fmi_unit_evaluate(unit *m)
{
    NAME_real u[UPPER_INPUTS];
    if (m->fresh) {
        return;
    }
    fmi_unit_inputs(m, u);
    if (m->phase <= STARTING) {
        fmi_unit_start(m, u);
    }
    m->due = 1;
    m->next = m->past;
    take_sample(&m->next, u, &m->u[UPPER_INPUTS], &m->now);
    m->fresh = 1;
}

/* What a sample adds to a sum over time. */
static double fmi_unit_part(const unit *m, int k)
{
    return fmi_total_steps[k] * (double)m->now.reported[fmi_total_outputs[k]];
}

/* Add a sample to the sums over time. */
static void fmi_unit_add(unit *m)
{
    int k;
    for (k = 0; k < TOTALS; k++) {
        m->total[k] += fmi_unit_part(m, k);
    }
}

static double fmi_unit_time(const unit *m)
{
    return m->start_time + (double)m->samples * UPPER_SAMPLE_TIME;
}

/* How many samples a step takes; 0 where it begins at another time, is no multiple of
 * the sample time, or ends behind the end. */
static int64_t fmi_unit_fits(const unit *m, double t, double h)
{
    const double now = fmi_unit_time(m);
    const double steps = floor(h / UPPER_SAMPLE_TIME + 0.5);
    const double off = fabs(h - steps * UPPER_SAMPLE_TIME);
    if (!(fabs(t - now) <= 1e-3 * UPPER_SAMPLE_TIME)) {
        return 0;
    }
    if (!(steps >= 1.0 && steps <= 1e15)) {
        return 0;
    }
    /* h is a difference of times: it has their rounding */
    if (!(off <= 1e-9 * h + 4.0 * DBL_EPSILON * (fabs(t) + h))) {
        return 0;
    }
    if (m->stops && now + h > m->stop_time + 1e-3 * UPPER_SAMPLE_TIME) {
        return 0;
    }
    return (int64_t)steps;
}

/* The last sample that was taken, of whatever instance: for tools that read memory by
 * the A2L file. */
volatile NAME_real NAME_in[UPPER_INPUTS];
volatile NAME_out NAME_now;

static void fmi_unit_take(unit *m, int64_t steps)
{
    NAME_real u[UPPER_INPUTS];
    int64_t n = 0;
    size_t k;
    fmi_unit_inputs(m, u);
    if (m->fresh) {
        m->past = m->next;
        fmi_unit_add(m);
        n = 1;
    }
    for (; n < steps; n++) {
        take_sample(&m->past, u, &m->u[UPPER_INPUTS], &m->now);
        fmi_unit_add(m);
    }
    m->samples += steps;
    m->fresh = 0;
    m->due = 0;
    for (k = 0; k < UPPER_INPUTS; k++) {
        NAME_in[k] = u[k];
    }
    NAME_now = m->now;
}

/* Values by reference. 0: there is no such value, or not now. */

static int fmi_unit_get_real(unit *m, unsigned int at, double *value)
{
    if (at < FMI_AT_REPORTED) {
        *value = m->u[at];
        return 1;
    }
    if (at > FMI_AT_START && at < FMI_AT_TIME) {
        *value = m->lag[at - FMI_AT_START - 1];
        return 1;
    }
    if (HAS_TIME && at == FMI_AT_TIME) {
        *value = fmi_unit_time(m);
        return 1;
    }
    if (at >= FMI_AT_START || (at >= FMI_AT_LIMITED && at < FMI_AT_PAST)) {
        return 0;
    }
    if (m->phase <= EVENT) {
        fmi_unit_evaluate(m);
    }
    if (at < FMI_AT_FLAG) {
        *value = (double)m->now.reported[at - FMI_AT_REPORTED];
    } else if (at < FMI_AT_LEARNT) {
        double flag[FLAGS + 1];
        fmi_unit_flags(&m->now, flag);
        *value = flag[at - FMI_AT_FLAG];
    } else if (at < FMI_AT_TOTAL) {
        double learnt[LEARNT + 1];
        fmi_unit_learnt(&m->past, learnt);
        *value = learnt[at - FMI_AT_LEARNT];
    } else if (at < FMI_AT_LIMITED) {
        const int k = (int)(at - FMI_AT_TOTAL);
        *value = m->total[k];
        if (m->due) {
            *value += fmi_unit_part(m, k);
        }
    } else {
        double past[PAST + 1];
        fmi_unit_past(run_of(&m->past), past);
        *value = past[at - FMI_AT_PAST];
    }
    return 1;
}

static int fmi_unit_get_limited(unit *m, unsigned int at, int *value)
{
    if (at < FMI_AT_LIMITED || at >= FMI_AT_PAST) {
        return 0;
    }
    if (m->phase <= EVENT) {
        fmi_unit_evaluate(m);
    }
    *value = m->now.limited[at - FMI_AT_LIMITED];
    return 1;
}

static int fmi_unit_may_set_real(const unit *m, unsigned int at)
{
    if (at < FMI_AT_REPORTED) {
        return m->phase != ENDED;
    }
    return at > FMI_AT_START && at < FMI_AT_TIME && m->phase <= STARTING;
}

static void fmi_unit_set_real(unit *m, unsigned int at, double value)
{
    if (at < FMI_AT_REPORTED) {
        m->u[at] = value;
    } else if (at > FMI_AT_START && at < FMI_AT_TIME) {
        m->lag[at - FMI_AT_START - 1] = value;
    }
    m->fresh = 0;
}

static int fmi_unit_set_start(unit *m, unsigned int at, int64_t kind)
{
    if (at != FMI_AT_START || m->phase > STARTING) {
        return 0;
    }
    if (kind < UPPER_STEADY || kind > UPPER_ZEROS) {
        return 0;
    }
    m->kind = (int)kind;
    m->fresh = 0;
    return 1;
}

/* Slopes of the reported outputs by inputs and past outputs, of the sample that is due:
 * rows of UPPER_INPUTS + PAST numbers. */
static void fmi_unit_slopes(unit *m, double *slope)
{
    const size_t columns = UPPER_INPUTS + PAST;
    NAME_real u[UPPER_INPUTS];
    NAME_real raw[UPPER_COMPUTED * (UPPER_INPUTS + PAST)];
    NAME_state next;
    NAME_out out;
    size_t o;
    size_t k;
    if (m->phase <= STARTING) {
        fmi_unit_evaluate(m);
    }
    fmi_unit_inputs(m, u);
    next = *run_of(&m->past);
    NAME_jacobian(&next, u, raw);
    NAME_step(&next, u, &out);
    for (o = 0; o < UPPER_REPORTED; o++) {
        /* what is held at the edge of its range does not move */
        const int free = out.reported[o] == out.fed[o];
        for (k = 0; k < columns; k++) {
            double one = free ? (double)raw[o * columns + k] : 0.0;
            if (k >= UPPER_INPUTS) {
                one /= fmi_past_gains[k - UPPER_INPUTS];
            }
            slope[o * columns + k] = one;
        }
    }
}

/* The column of a value that slopes are by; -1: of none. */
static int fmi_unit_column(unsigned int at)
{
    if (at < FMI_AT_REPORTED) {
        return (int)at;
    }
    if (at < FMI_AT_PAST || at >= FMI_AT_START) {
        return -1;
    }
    return (int)(at - FMI_AT_PAST + UPPER_INPUTS);
}

/* sum of slope * seed, forward from `knowns` to `unknowns`, or back if `adjoint`. */
static int fmi_unit_derivative(unit *m, const unsigned int *unknowns, size_t outputs,
                               const unsigned int *knowns, size_t inputs,
                               const double *seed, double *found, int adjoint)
{
    double slope[UPPER_REPORTED * (UPPER_INPUTS + PAST)];
    size_t o;
    size_t k;
    if (LEARNS) {
        return 0;
    }
    for (o = 0; o < outputs; o++) {
        if (unknowns[o] < FMI_AT_REPORTED || unknowns[o] >= FMI_AT_FLAG) {
            return 0;
        }
    }
    for (k = 0; k < inputs; k++) {
        if (fmi_unit_column(knowns[k]) < 0) {
            return 0;
        }
    }
    fmi_unit_slopes(m, slope);
    memset(found, 0, (adjoint ? inputs : outputs) * sizeof(*found));
    for (o = 0; o < outputs; o++) {
        for (k = 0; k < inputs; k++) {
            const size_t row = unknowns[o] - FMI_AT_REPORTED;
            const size_t column = (size_t)fmi_unit_column(knowns[k]);
            const double one = slope[row * (UPPER_INPUTS + PAST) + column];
            if (adjoint) {
                found[k] += one * seed[o];
            } else {
                found[o] += one * seed[k];
            }
        }
    }
    return 1;
}

/* States that an importer keeps. */

static unit *fmi_unit_copy(const unit *m, unit *place)
{
    unit *copy = place != NULL ? place : malloc(sizeof(*copy));
    if (copy != NULL) {
        memcpy(copy, m, sizeof(*copy));
    }
    return copy;
}

static int fmi_unit_pack(const unit *m, void *bytes, size_t size)
{
    if (size != sizeof(kept_unit)) {
        return 0;
    }
    memcpy(bytes, TOKEN, sizeof(TOKEN));
    memcpy((char *)bytes + offsetof(kept_unit, m), m, sizeof(*m));
    return 1;
}

/* 0: not from this model, or of another size. */
static int fmi_unit_unpack(unit *m, const void *bytes, size_t size)
{
    if (size != sizeof(kept_unit) || memcmp(bytes, TOKEN, sizeof(TOKEN)) != 0) {
        return 0;
    }
    memcpy(m, (const char *)bytes + offsetof(kept_unit, m), sizeof(*m));
    return 1;
}
