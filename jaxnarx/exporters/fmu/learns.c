/* A model that learns from the outputs as they are measured, while it is told to. */

typedef NAME_adaptation memory;

static void begin_memory(memory *m, const NAME_state *begun)
{
    memset(m, 0, sizeof(*m));
    NAME_adapt_begin(m, begun);
}

/* y: measured outputs, then whether to learn. */
static void take_sample(memory *m, const NAME_real *u, const double *y, NAME_out *out)
{
    NAME_real seen[UPPER_REPORTED];
    size_t k;
    for (k = 0; k < UPPER_REPORTED; k++) {
        seen[k] = (NAME_real)y[k];
    }
    m->learn = y[UPPER_REPORTED] > 0.5;
    NAME_adapt(m, u, seen, out);
}

static const NAME_state *run_of(const memory *m)
{
    return &m->model;
}

static void fmi_unit_learnt(const memory *m, double *v)
{
    size_t k;
    for (k = 0; k < UPPER_REPORTED; k++) {
        v[4 * k] = (double)m->rmse[k];
        v[4 * k + 1] = (double)m->rmse_start[k];
        v[4 * k + 2] = (double)m->drift[k];
        v[4 * k + 3] = (double)m->undone[k];
    }
}
