typedef struct {
    int groups;
    int numbers;
    const int *terms;
    const int *at;
    const NAME_real *first;
} learnt_part;

static NAME_real limit(NAME_real x, NAME_real low, NAME_real high)
{
    const NAME_real above = (x > low) ? x : low;
    return (above < high) ? above : high;
}

static void restore(const learnt_part *p, NAME_real *theta, const NAME_real *from)
{
    int k;
    for (k = 0; k < p->numbers; k++) {
        theta[k] = from[k];
    }
}

/* roots of covariances: FIRST times the unit matrix */
static void reset(const learnt_part *p, NAME_real *root)
{
    int g;
    int k;
    int at = 0;
    for (g = 0; g < p->groups; g++) {
        const int n = p->terms[g];
        for (k = 0; k < (n * n); k++) {
            root[at + k] = ((k % (n + 1)) == 0) ? ROOT(FIRST) : (NAME_real)0.0;
        }
        at += n * n;
    }
}

/* what these coefficients say */
static NAME_real answer(const learnt_part *p, const NAME_real *theta,
    const NAME_real *x, const NAME_real *share)
{
    NAME_real total = 0.0;
    int g;
    int k;
    int at = 0;
    for (g = 0; g < p->groups; g++) {
        NAME_real own = 0.0;
        for (k = 0; k < p->terms[g]; k++) {
            own += theta[p->at[at + k]] * x[at + k];
        }
        total += share[g] * own;
        at += p->terms[g];
    }
    return total;
}

/* one group: recursive least squares by a root of P */
static void update(int n, const int *places, NAME_real *theta, NAME_real *root,
    const NAME_real *x, NAME_real y, NAME_real share)
{
    NAME_real f[MOST_TERMS];
    NAME_real gain[MOST_TERMS];
    NAME_real trace = 0.0;
    NAME_real news = 0.0;
    NAME_real error = y;
    NAME_real fade = (NAME_real)1.0 - (((NAME_real)1.0 - FORGETTING) * share);
    int i;
    int j;
    for (i = 0; i < n; i++) {
        f[i] = 0.0;
        gain[i] = 0.0;
        for (j = 0; j < n; j++) {
            f[i] += root[(i * n) + j] * x[j];
            trace += root[(i * n) + j] * root[(i * n) + j];
        }
        news += f[i] * f[i];
        error -= theta[places[i]] * x[i];
    }
    news *= share;
    if ((share > (NAME_real)0.0) && (news >= LEAST_NEWS)) {
        NAME_real a;
        NAME_real larger;
        NAME_real shrink;
        if (trace > (LARGEST_TRACE * FIRST * (NAME_real)n * fade)) {
            fade = 1.0;
        }
        a = fade + news;
        larger = (NAME_real)1.0 / ROOT(fade);
        shrink = share * larger / (a + ROOT(fade * a));
        for (i = 0; i < n; i++) {
            for (j = 0; j < n; j++) {
                gain[j] += root[(i * n) + j] * f[i];
            }
        }
        for (i = 0; i < n; i++) {
            const NAME_real less = f[i] * shrink;
            for (j = 0; j < n; j++) {
                root[(i * n) + j] = (root[(i * n) + j] * larger) - (less * gain[j]);
            }
            theta[places[i]] += (share * error / a) * gain[i];
        }
    }
}

/* all groups of an output; together they learn what the other models leave */
static void learn(const learnt_part *p, NAME_real *theta, NAME_real *root,
    const NAME_real *x, const NAME_real *share, NAME_real y, NAME_real predicted,
    int joint)
{
    const NAME_real error = y - predicted;
    const NAME_real size = (error < (NAME_real)0.0) ? -error : error;
    NAME_real target = y;
    int g;
    int at = 0;
    int corner = 0;
    if (joint != 0) {
        target = error + answer(p, theta, x, share);
    }
    for (g = 0; (g < p->groups) && (size > DEAD_ZONE); g++) {
        const int n = p->terms[g];
        update(n, &p->at[at], theta, &root[corner], &x[at], target, share[g]);
        at += n;
        corner += n * n;
    }
}

static void note(NAME_adaptation *a, int o, NAME_real y, NAME_real predicted,
    NAME_real started)
{
    NAME_real *const sums = &a->sums[3 * o];
    sums[0] += (y - predicted) * (y - predicted);
    sums[1] += (y - started) * (y - started);
    sums[2] += (predicted - started) * (predicted - started);
    a->count[o]++;
}

/* the end of a window: keep what was learnt, or go back; 1: it was undone */
static int judge(NAME_adaptation *a, int o, const learnt_part *p, NAME_real *theta,
    NAME_real *good, NAME_real *root, NAME_real gain)
{
    NAME_real *const sums = &a->sums[3 * o];
    const NAME_real count = (a->count[o] > 0) ? (NAME_real)a->count[o] : (NAME_real)1.0;
    const NAME_real error = sums[0] / count;
    const NAME_real started = sums[1] / count;
    const NAME_real least = LEAST_ERROR * LEAST_ERROR;
    const NAME_real most = GROWTH * GROWTH * ((started > least) ? started : least);
    int fine = (error <= most) ? 1 : 0;
    int g;
    int k;
    int all = 0;
    for (g = 0; g < p->groups; g++) {
        all += p->terms[g] * p->terms[g];
    }
    for (k = 0; k < all; k++) {
        fine = (isfinite(root[k]) != 0) ? fine : 0;
    }
    for (k = 0; k < p->numbers; k++) {
        fine = (isfinite(theta[k]) != 0) ? fine : 0;
    }
    if (a->count[o] > 0) {
        a->rmse[o] = ROOT(error) * gain;
        a->rmse_start[o] = ROOT(started) * gain;
        a->drift[o] = ROOT(sums[2] / count) * gain;
    }
    if (fine != 0) {
        restore(p, good, theta);
    } else {
        restore(p, theta, good);
        restore(p, good, p->first);
        reset(p, root);
        a->undone[o]++;
    }
    sums[0] = 0.0;
    sums[1] = 0.0;
    sums[2] = 0.0;
    a->count[o] = 0;
    return (fine != 0) ? 0 : 1;
}
