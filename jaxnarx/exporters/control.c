/* the larger of two, NaN where one is */
static double larger(double a, double b)
{
    return ((a > b) || isnan(a)) ? a : b;
}

static double smaller(double a, double b)
{
    return (a < b) ? a : b;
}

/* whether a value is one, see the header */
static int is_there(double value, double largest)
{
    return (fabs(value) < largest) ? 1 : 0;
}

/* to = a b, n rows of a with m numbers, b with p columns */
static void multiply(int n, int m, int p, const double *a, const double *b, double *to)
{
    int i;
    int j;
    int k;
    for (i = 0; i < n; i++) {
        for (j = 0; j < p; j++) {
            double sum = 0.0;
            for (k = 0; k < m; k++) {
                sum += a[(i * m) + k] * b[(k * p) + j];
            }
            to[(i * p) + j] = sum;
        }
    }
}

/* to = diag(own) + a b', n rows of either with m numbers */
static void multiply_transposed(int n, int m, const double *a, const double *b,
    const double *own, double *to)
{
    int i;
    int j;
    int k;
    for (i = 0; i < n; i++) {
        for (j = 0; j < n; j++) {
            double sum = (i == j) ? own[i] : 0.0;
            for (k = 0; k < m; k++) {
                sum += a[(i * m) + k] * b[(j * m) + k];
            }
            to[(i * n) + j] = sum;
        }
    }
}

/* a = L L', L in the lower triangle; 0: a is not positive definite */
static int factorise(int n, double *a)
{
    int good = 1;
    int i;
    int j;
    int k;
    for (j = 0; j < n; j++) {
        double pivot = a[(j * n) + j];
        for (k = 0; k < j; k++) {
            pivot -= a[(j * n) + k] * a[(j * n) + k];
        }
        if (!(pivot > 0.0)) {
            good = 0;
        }
        pivot = sqrt(pivot);
        a[(j * n) + j] = pivot;
        for (i = j + 1; i < n; i++) {
            double sum = a[(i * n) + j];
            for (k = 0; k < j; k++) {
                sum -= a[(i * n) + k] * a[(j * n) + k];
            }
            a[(i * n) + j] = sum / pivot;
        }
    }
    return good;
}

/* L L' x = b, in the place of b */
static void solve_factors(int n, const double *l, double *b)
{
    int i;
    int k;
    for (i = 0; i < n; i++) {
        for (k = 0; k < i; k++) {
            b[i] -= l[(i * n) + k] * b[k];
        }
        b[i] /= l[(i * n) + i];
    }
    for (i = n - 1; i >= 0; i--) {
        for (k = i + 1; k < n; k++) {
            b[i] -= l[(k * n) + i] * b[k];
        }
        b[i] /= l[(i * n) + i];
    }
}

/* a x = b by elimination with pivots, x in the place of b; 0: a is singular */
static int eliminate(int n, double *a, double *b)
{
    int good = 1;
    int i;
    int j;
    int k;
    for (j = 0; (j < n) && (good != 0); j++) {
        int best = j;
        double kept;
        for (i = j + 1; i < n; i++) {
            if (fabs(a[(i * n) + j]) > fabs(a[(best * n) + j])) {
                best = i;
            }
        }
        good = (fabs(a[(best * n) + j]) > 0.0) ? 1 : 0;
        for (k = 0; k < n; k++) {
            kept = a[(j * n) + k];
            a[(j * n) + k] = a[(best * n) + k];
            a[(best * n) + k] = kept;
        }
        kept = b[j];
        b[j] = b[best];
        b[best] = kept;
        for (i = j + 1; (i < n) && (good != 0); i++) {
            const double part = a[(i * n) + j] / a[(j * n) + j];
            for (k = j; k < n; k++) {
                a[(i * n) + k] -= part * a[(j * n) + k];
            }
            b[i] -= part * b[j];
        }
    }
    for (i = n - 1; (i >= 0) && (good != 0); i--) {
        for (k = i + 1; k < n; k++) {
            b[i] -= a[(i * n) + k] * b[k];
        }
        b[i] /= a[(i * n) + i];
    }
    return good;
}

/* whether an entry of the state is the root of a value, see loop_root */
static int is_root(int entry)
{
    const int n = loop_of[entry];
    return ((n >= 0) && (loop_root[(n >= 0) ? n : 0] != 0)) ? 1 : 0;
}

/* slope of an entry of the state by the value whose root it may be */
static double by_value(const double *x, int entry)
{
    double slope = 1.0;
    if (is_root(entry) != 0) {
        slope = 0.5 / larger(fabs(x[entry]), 0.5 * LEAST_ROOT);
        slope = (fabs(x[entry]) > LEAST_ROOT) ? slope : (1.0 / LEAST_ROOT);
    }
    return slope;
}

/* the value of an entry of the state; above the floor of its root, if it is one */
static double value_of(const double *x, int entry)
{
    return (is_root(entry) != 0) ? (x[entry] * fabs(x[entry])) : x[entry];
}

/* entry m of the Jacobian of c->next by c->x, between values */
static double between_values(const NAME_controller *c, int m)
{
    double own = c->a[m] * by_value(c->x, a_column[m]);
    if (is_root(a_row[m]) != 0) {
        own *= 2.0 * fabs(c->next[a_row[m]]);
    }
    return own;
}

/* move an entry of the state by so much of the value whose root it may be */
static void move_entry(double *x, int entry, double by)
{
    if (is_root(entry) != 0) {
        const double far = (x[entry] * fabs(x[entry])) + by;
        x[entry] = (far > 0.0) ? sqrt(far) : (-sqrt(-far));
    } else {
        x[entry] += by;
    }
}

/* the state whose loop has had these values, of which it may keep roots */
static void rest_at(NAME_controller *c, const double *u, const double *z)
{
    double kept[LOOPS + 1];
    int n;
    for (n = 0; n < LOOPS; n++) {
        kept[n] = z[n];
        if (loop_root[n] != 0) {
            kept[n] = (z[n] > 0.0) ? sqrt(z[n]) : (-sqrt(-z[n]));
        }
    }
    rest(u, kept, c->x);
}

/* the state of rest under u: Newton's method on the values that are fed back, from the
   middle of their ranges; where it finds none, they have been there */
static void find_rest(NAME_controller *c, const double *u)
{
    double z[LOOPS + 1];
    double move[LOOPS + 1];
    double slope[(LOOPS * LOOPS) + 1];
    int found = (LOOPS > 0) ? 0 : 1;
    int step;
    int n;
    int m;
    for (n = 0; n < LOOPS; n++) {
        z[n] = loop_middle[n];
    }
    for (step = 0; (step < REST_STEPS) && (found == 0); step++) {
        double most = 0.0;
        rest_at(c, u, z);
        slopes(c->x, u, c->next, c->y, c->a, c->b, c->c, c->d);
        for (n = 0; n < LOOPS; n++) {
            move[n] = z[n] - value_of(c->next, loop_first[n]);
            for (m = 0; m < LOOPS; m++) {
                slope[(n * LOOPS) + m] = (n == m) ? -1.0 : 0.0;
            }
        }
        for (m = 0; m < A_ENTRIES; m++) {
            const int to = loop_of[a_row[m]];
            const int from = loop_of[a_column[m]];
            if ((to >= 0) && (from >= 0) && (loop_first[to] == a_row[m])) {
                slope[(to * LOOPS) + from] += between_values(c, m);
            }
        }
        if (eliminate(LOOPS, slope, move) == 0) {
            break;
        }
        for (n = 0; n < LOOPS; n++) {
            z[n] += move[n];
            most = larger(most, fabs(move[n]));
        }
        found = (most <= REST_TOLERANCE) ? 1 : 0;
    }
    for (n = 0; (n < LOOPS) && (found == 0); n++) {
        z[n] = loop_middle[n];
    }
    rest_at(c, u, z);
}

/* the estimate begins: covariance as unsure as after many steps */
static void begin_covariance(NAME_controller *c)
{
    int i;
    int j;
    for (i = 0; i < OWN; i++) {
        for (j = 0; j < OWN; j++) {
            c->covariance[(i * OWN) + j] = (i == j) ? first_variance[i] : 0.0;
        }
    }
}

void NAME_control_begin(NAME_controller *c, const double *u, const double *measured)
{
    int k;
    int n;
    for (k = 0; k < INPUTS; k++) {
        c->u[k] = (is_there(u[k], largest_input[k]) != 0) ? u[k] : input_middle[k];
    }
    find_rest(c, c->u);
    sample(c->x, c->u, c->next, c->y, c->fed);
    for (k = 0; k < OUTPUTS; k++) {
        const int there = is_there(measured[k], largest_output[k]);
        c->offset[k] = (there != 0) ? (measured[k] - c->y[k]) : 0.0;
        c->fading[k] = 0.0;
    }
    begin_covariance(c);
    for (k = 0; k < HORIZON; k++) {
        for (n = 0; n < COMMANDS; n++) {
            c->plan[(k * COMMANDS) + n] = c->u[command_at[n]];
        }
    }
    for (k = 0; k < USED; k++) {
        c->slow[k] = c->u[used_at[k]];
    }
}

/* whether the run stands at a bound of its feedback */
static int is_clipped(NAME_controller *c, const double *x)
{
    int clipped = 0;
    int k;
    sample(x, c->u, c->next, c->y, c->fed);
    for (k = 0; k < OUTPUTS; k++) {
        const int within =
            ((c->fed[k] > loop_low[k]) && (c->fed[k] < loop_high[k])) ? 1 : 0;
        if ((loop_free[k] != 0) && (within == 0)) {
            clipped = 1;
        }
    }
    return clipped;
}

/* begin anew from what was measured where the run stands at its bounds */
static int recover(NAME_controller *c, const double *measured)
{
    int lost = RECOVERS;
    int k;
    int n;
    for (k = 0; k < OUTPUTS; k++) {
        const int within =
            ((measured[k] > loop_low[k]) && (measured[k] < loop_high[k])) ? 1 : 0;
        const int there = is_there(measured[k], largest_output[k]);
        if ((there == 0) || ((loop_free[k] != 0) && (within == 0))) {
            lost = 0;
        }
    }
    if ((lost != 0) && (is_clipped(c, c->x) != 0)) {
        for (k = 0; k < STATES; k++) {
            c->moved[k] = c->x[k];
        }
        for (n = 0; n < LOOPS; n++) {
            for (k = 0; k < loop_length[n]; k++) {
                c->moved[loop_first[n] + k] = measured[loop_output[n]] / loop_gain[n];
            }
        }
        lost = (is_clipped(c, c->moved) == 0) ? 1 : 0;
        if (lost != 0) {
            for (k = 0; k < STATES; k++) {
                c->x[k] = c->moved[k];
            }
            for (k = 0; k < OUTPUTS; k++) {
                c->offset[k] = 0.0;
                c->fading[k] = 0.0;
            }
            begin_covariance(c);
        }
    } else {
        lost = 0;
    }
    return lost;
}

/* correct the estimate by errors of that noise; c->middle is factorised */
static void take_measured(NAME_controller *c, const double *noise, const double *error)
{
    double column[OUTPUTS];
    int i;
    int j;
    int k;
    for (j = 0; j < OWN; j++) {
        for (k = 0; k < OUTPUTS; k++) {
            column[k] = c->product[(k * OWN) + j];
        }
        solve_factors(OUTPUTS, c->middle, column);
        for (k = 0; k < OUTPUTS; k++) {
            c->gain[(j * OUTPUTS) + k] = column[k];
        }
    }
    /* (I - gain seen) P (I - gain seen)' + gain noise gain' */
    for (i = 0; i < OWN; i++) {
        for (j = 0; j < OWN; j++) {
            double sum = c->covariance[(i * OWN) + j];
            for (k = 0; k < OUTPUTS; k++) {
                sum -= c->gain[(i * OUTPUTS) + k] * c->product[(k * OWN) + j];
            }
            c->half[(i * OWN) + j] = sum;
        }
    }
    for (i = 0; i < OWN; i++) {
        for (k = 0; k < OUTPUTS; k++) {
            double sum = 0.0;
            for (j = 0; j < OWN; j++) {
                sum += c->half[(i * OWN) + j] * c->seen[(k * OWN) + j];
            }
            column[k] = sum;
        }
        for (j = 0; j < OWN; j++) {
            double sum = c->half[(i * OWN) + j];
            for (k = 0; k < OUTPUTS; k++) {
                const double own = c->gain[(i * OUTPUTS) + k] * noise[k];
                sum += (own - column[k]) * c->gain[(j * OUTPUTS) + k];
            }
            c->covariance[(i * OWN) + j] = sum;
        }
    }
    for (i = 0; i < OWN; i++) {
        double move = 0.0;
        for (k = 0; k < OUTPUTS; k++) {
            move += c->gain[(i * OUTPUTS) + k] * error[k];
        }
        if (i < CARRIED) {
            move_entry(c->x, carried_at[i], move);
        } else if (i < (CARRIED + OUTPUTS)) {
            c->offset[i - CARRIED] += move;
        } else {
            c->fading[i - CARRIED - OUTPUTS] += move;
        }
    }
}

/* extended Kalman filter: what was measured */
static void correct(NAME_controller *c, const double *measured)
{
    double noise[OUTPUTS];
    double error[OUTPUTS];
    int i;
    int k;
    slopes(c->x, c->u, c->next, c->y, c->a, c->b, c->c, c->d);
    for (i = 0; i < (OUTPUTS * OWN); i++) {
        c->seen[i] = 0.0;
    }
    for (i = 0; (i < C_ENTRIES) && (OWN > (2 * OUTPUTS)); i++) {
        if (carried_of[c_column[i]] >= 0) {
            c->seen[(c_row[i] * OWN) + carried_of[c_column[i]]] =
                c->c[i] * by_value(c->x, c_column[i]);
        }
    }
    for (k = 0; k < OUTPUTS; k++) {
        const int there = is_there(measured[k], largest_output[k]);
        c->seen[(k * OWN) + CARRIED + k] = 1.0;
        c->seen[(k * OWN) + CARRIED + OUTPUTS + k] = 1.0;
        noise[k] = (there != 0) ? noise_variance[k] : (noise_variance[k] * NOT_MEASURED);
        error[k] = (there == 0) ? 0.0 :
            (measured[k] - c->y[k] - c->offset[k] - c->fading[k]);
    }
    multiply(OUTPUTS, OWN, OWN, c->seen, c->covariance, c->product);
    multiply_transposed(OUTPUTS, OWN, c->product, c->seen, noise, c->middle);
    if (factorise(OUTPUTS, c->middle) == 0) {
        begin_covariance(c);
    } else {
        take_measured(c, noise, error);
    }
}

/* the estimate before the next sample, under c->u */
static void advance(NAME_controller *c)
{
    int i;
    int k;
    slopes(c->x, c->u, c->next, c->y, c->a, c->b, c->c, c->d);
    for (i = 0; i < (OWN * OWN); i++) {
        c->transition[i] = 0.0;
    }
    for (i = 0; (i < A_ENTRIES) && (CARRIED > 0); i++) {
        const int row = carried_of[a_row[i]];
        const int column = carried_of[a_column[i]];
        if ((row >= 0) && (column >= 0)) {
            const int newest = (loop_first[loop_of[a_row[i]]] == a_row[i]) ? 1 : 0;
            c->transition[(row * OWN) + column] =
                (newest != 0) ? between_values(c, i) : c->a[i];
        }
    }
    for (k = 0; k < OUTPUTS; k++) {
        const int at = CARRIED + k;
        const int behind = CARRIED + OUTPUTS + k;
        c->transition[(at * OWN) + at] = 1.0;
        c->transition[(behind * OWN) + behind] = pole[k];
        c->fading[k] *= pole[k];
    }
    multiply(OWN, OWN, OWN, c->transition, c->covariance, c->half);
    multiply_transposed(OWN, OWN, c->half, c->transition, step_variance, c->covariance);
    for (i = 0; i < STATES; i++) {
        c->x[i] = c->next[i];
    }
}

/* a command of the plan c->z, exactly at a bound where it is near */
static double command_of(const NAME_controller *c, int k, int i)
{
    double own = c->z[(block_of[k] * COMMANDS) + i] * span[i];
    own = (fabs(own - low[i]) <= (AT_EDGE * span[i])) ? low[i] : own;
    return (fabs(own - high[i]) <= (AT_EDGE * span[i])) ? high[i] : own;
}

/* numbers of the plan that a row of the horizon depends on */
static int reach_of(int k)
{
    const int at = ((k + FIRST) < HORIZON) ? (k + FIRST) : (HORIZON - 1);
    return (block_of[at] + 1) * COMMANDS;
}

/* one step of the slopes by the plan: moved = a slope + b, then the outputs' */
static void move_slopes(NAME_controller *c, int k, int numbers, double *row)
{
    const int last = (k < HORIZON) ? k : (HORIZON - 1);
    const int block = block_of[last] * COMMANDS;
    int i;
    int n;
    if (row != NULL) {
        for (i = 0; i < (OUTPUTS * NUMBERS); i++) {
            row[i] = 0.0;
        }
        for (i = 0; i < C_ENTRIES; i++) {
            const double own = c->c[i] / size[c_row[i]];
            const double *const from = &c->slope[c_column[i] * NUMBERS];
            double *const to = &row[c_row[i] * NUMBERS];
            for (n = 0; n < numbers; n++) {
                to[n] += own * from[n];
            }
        }
        for (i = 0; i < D_ENTRIES; i++) {
            row[(d_row[i] * NUMBERS) + block + d_column[i]] +=
                c->d[i] * span[d_column[i]] / size[d_row[i]];
        }
    }
    for (i = 0; i < (STATES * NUMBERS); i++) {
        c->moved[i] = 0.0;
    }
    for (i = 0; i < A_ENTRIES; i++) {
        const double own = c->a[i];
        const double *const from = &c->slope[a_column[i] * NUMBERS];
        double *const to = &c->moved[a_row[i] * NUMBERS];
        for (n = 0; n < numbers; n++) {
            to[n] += own * from[n];
        }
    }
    for (i = 0; i < B_ENTRIES; i++) {
        double *const to = &c->moved[(b_row[i] * NUMBERS) + block];
        to[b_column[i]] += c->b[i] * span[b_column[i]];
    }
    for (i = 0; i < (STATES * NUMBERS); i++) {
        c->slope[i] = c->moved[i];
    }
}

/* the domain's index, with slopes, at sample k under the inputs `now` */
static void look_at_domain(NAME_controller *c, int k)
{
    double *const row = &c->steep[((k * COLUMNS) + OUTPUTS) * NUMBERS];
    const int block = block_of[k] * COMMANDS;
    double square = ROUND_OFF;
    int i;
    int j;
    int n;
    for (i = 0; i < USED; i++) {
        c->passed[i] *= fade[i];
        c->passed[i] += (1.0 - fade[i]) * c->now[used_at[i]];
        for (n = 0; n < NUMBERS; n++) {
            c->passed_slope[(i * NUMBERS) + n] *= fade[i];
        }
        if (used_command[i] >= 0) {
            c->passed_slope[(i * NUMBERS) + block + used_command[i]] +=
                (1.0 - fade[i]) * span[used_command[i]];
        }
    }
    for (n = 0; n < NUMBERS; n++) {
        row[n] = 0.0;
    }
    for (j = 0; j < (2 * USED); j++) {
        double value = 0.0;
        for (i = 0; i < USED; i++) {
            const double *const own = &whiten[j * 2 * USED];
            value += own[i] * (c->now[used_at[i]] - middle_of[i]);
            value += own[USED + i] * (c->passed[i] - middle_of[USED + i]);
        }
        square += value * value;
        for (i = 0; i < USED; i++) {
            const double *const own = &whiten[j * 2 * USED];
            for (n = 0; n < NUMBERS; n++) {
                row[n] += value * own[USED + i] * c->passed_slope[(i * NUMBERS) + n];
            }
            if (used_command[i] >= 0) {
                row[block + used_command[i]] += value * own[i] * span[used_command[i]];
            }
        }
    }
    square = sqrt(square);
    c->out[(k * COLUMNS) + OUTPUTS] = square;
    for (n = 0; n < NUMBERS; n++) {
        row[n] /= square;
    }
}

/* the run over the horizon under c->z, with slopes */
static void linearise(NAME_controller *c, const double *given)
{
    double faded[OUTPUTS];
    int i;
    int k;
    for (i = 0; i < STATES; i++) {
        c->run[i] = c->x[i];
    }
    for (i = 0; i < (STATES * NUMBERS); i++) {
        c->slope[i] = 0.0;
    }
    for (i = 0; i < USED; i++) {
        c->passed[i] = c->slow[i];
    }
    for (i = 0; i < (USED * NUMBERS); i++) {
        c->passed_slope[i] = 0.0;
    }
    for (i = 0; i < OUTPUTS; i++) {
        faded[i] = c->fading[i];
    }
    for (k = 0; k < (HORIZON + FIRST); k++) {
        const int at = (k < HORIZON) ? k : (HORIZON - 1);
        for (i = 0; i < COMMANDS; i++) {
            c->now[command_at[i]] = command_of(c, at, i);
        }
        for (i = 0; i < GIVEN; i++) {
            c->now[given_at[i]] = given[(at * GIVEN) + i];
        }
        slopes(c->run, c->now, c->next, c->y, c->a, c->b, c->c, c->d);
        if (k >= FIRST) {
            const int row = (k - FIRST) * COLUMNS;
            for (i = 0; i < OUTPUTS; i++) {
                c->out[row + i] = (c->y[i] + c->offset[i] + faded[i]) / size[i];
            }
            move_slopes(c, k, reach_of(k - FIRST), &c->steep[row * NUMBERS]);
        } else {
            move_slopes(c, k, NUMBERS, NULL);
        }
        if ((k < HORIZON) && (COLUMNS > OUTPUTS)) {
            look_at_domain(c, k);
        }
        for (i = 0; i < STATES; i++) {
            c->run[i] = c->next[i];
        }
        for (i = 0; i < OUTPUTS; i++) {
            faded[i] *= pole[i];
        }
    }
}

/* half the Hessian, and half the gradient, of errors and moves */
static void make_objective(NAME_controller *c, const double *reference)
{
    int i;
    int j;
    int k;
    int n;
    for (i = 0; i < (VARIABLES * VARIABLES); i++) {
        c->hessian[i] = 0.0;
    }
    for (i = 0; i < NUMBERS; i++) {
        const int own = i % COMMANDS;
        const double before = (i < COMMANDS) ? (c->u[command_at[own]] / span[own]) :
            c->z[i - COMMANDS];
        c->change[i] = c->z[i] - before;
        c->gradient[i] = 0.0;
    }
    for (i = 0; i < NUMBERS; i++) {
        const double price = effort[i % COMMANDS];
        double *const row = &c->hessian[i * VARIABLES];
        row[i] += price + LEAST_CURVATURE;
        c->gradient[i] += price * c->change[i];
        if ((i + COMMANDS) < NUMBERS) {
            row[i] += price;
            row[i + COMMANDS] -= price;
            c->hessian[((i + COMMANDS) * VARIABLES) + i] -= price;
            c->gradient[i] -= price * c->change[i + COMMANDS];
        }
    }
    for (k = 0; k < HORIZON; k++) {
        const int numbers = reach_of(k);
        for (n = 0; n < TARGETS; n++) {
            const int o = target_at[n];
            const double *const row = &c->steep[((k * COLUMNS) + o) * NUMBERS];
            const double error = c->out[(k * COLUMNS) + o] -
                (reference[(k * TARGETS) + n] / size[o]);
            for (i = 0; i < numbers; i++) {
                const double weighted = row[i] * (weight_of[n] / (double)HORIZON);
                c->gradient[i] += weighted * error;
                for (j = 0; j < numbers; j++) {
                    c->hessian[(i * VARIABLES) + j] += weighted * row[j];
                }
            }
        }
    }
    for (i = 0; i < SOFT; i++) {
        c->hessian[((NUMBERS + i) * VARIABLES) + NUMBERS + i] = soft_square[i];
        c->gradient[NUMBERS + i] = 0.5 * soft_linear[i];
    }
}

/* bounds of a number of the plan: beyond its own, a command comes back as fast as its
   rate allows */
static double most_of(const NAME_controller *c, int i)
{
    const int own = i % COMMANDS;
    const int moves = (i / COMMANDS) + 1;
    const double far = (double)moves * largest_move[own];
    return larger(high[own], c->u[command_at[own]] - far);
}

static double least_of(const NAME_controller *c, int i)
{
    const int own = i % COMMANDS;
    const int moves = (i / COMMANDS) + 1;
    const double far = (double)moves * largest_move[own];
    return smaller(low[own], c->u[command_at[own]] + far);
}

/* c->z within its bounds, its first block within the rates too: a solution keeps them up
   to its residual alone */
static void keep_bounds(NAME_controller *c)
{
    int i;
    for (i = 0; i < NUMBERS; i++) {
        const int own = i % COMMANDS;
        const double before = c->u[command_at[own]];
        double most = most_of(c, i);
        double least = least_of(c, i);
        if (i < COMMANDS) {
            most = smaller(most, before + largest_move[own]);
            least = larger(least, before - largest_move[own]);
        }
        c->z[i] = larger(least / span[own], smaller(most / span[own], c->z[i]));
    }
}

/* bounds on a step: of commands, of moves, of outputs and the domain */
static void make_bounds(NAME_controller *c)
{
    int i;
    int k;
    int n;
    for (i = 0; i < NUMBERS; i++) {
        const int own = i % COMMANDS;
        const double reach = largest_move[own] / span[own];
        c->bound[i] = (most_of(c, i) / span[own]) - c->z[i];
        c->bound[NUMBERS + i] = c->z[i] - (least_of(c, i) / span[own]);
        c->bound[(2 * NUMBERS) + i] = reach - c->change[i];
        c->bound[(3 * NUMBERS) + i] = reach + c->change[i];
    }
    for (k = 0; k < HORIZON; k++) {
        for (i = 0; i < SOFT; i++) {
            const int at = (k * COLUMNS) + soft_column[i];
            const double y = c->out[at];
            for (n = 0; (n < NUMBERS) && !isfinite(y); n++) {
                c->steep[(at * NUMBERS) + n] = 0.0;
            }
            c->bound[(4 * NUMBERS) + (k * SOFT) + i] = soft_high[i] - y;
            c->bound[(4 * NUMBERS) + ((HORIZON + k) * SOFT) + i] = y - soft_low[i];
        }
    }
    for (i = 0; i < SOFT; i++) {
        c->bound[ROWS - SOFT + i] = 0.0;
    }
    for (i = 0; i < ROWS; i++) {
        c->there[i] = isfinite(c->bound[i]) ? 1.0 : 0.0;
        c->bound[i] = isfinite(c->bound[i]) ? c->bound[i] : 1.0;
    }
}

/* the rows of the constraints times v */
static void multiply_rows(const NAME_controller *c, const double *v, double *to)
{
    int i;
    int k;
    int n;
    for (i = 0; i < NUMBERS; i++) {
        const double moved = v[i] - ((i < COMMANDS) ? 0.0 : v[i - COMMANDS]);
        to[i] = v[i];
        to[NUMBERS + i] = -v[i];
        to[(2 * NUMBERS) + i] = moved;
        to[(3 * NUMBERS) + i] = -moved;
    }
    for (k = 0; k < HORIZON; k++) {
        const int numbers = reach_of(k);
        for (i = 0; i < SOFT; i++) {
            const double *const row =
                &c->steep[((k * COLUMNS) + soft_column[i]) * NUMBERS];
            double sum = 0.0;
            for (n = 0; n < numbers; n++) {
                sum += row[n] * v[n];
            }
            to[(4 * NUMBERS) + (k * SOFT) + i] = sum - v[NUMBERS + i];
            to[(4 * NUMBERS) + ((HORIZON + k) * SOFT) + i] = -sum - v[NUMBERS + i];
        }
    }
    for (i = 0; i < SOFT; i++) {
        to[ROWS - SOFT + i] = -v[NUMBERS + i];
    }
    for (i = 0; i < ROWS; i++) {
        to[i] = (c->there[i] > 0.0) ? to[i] : 0.0;
    }
}

/* v plus the transposed rows times l */
static void add_transposed(const NAME_controller *c, const double *l, double *v)
{
    const double *const on = c->there;
    int i;
    int k;
    int n;
    for (i = 0; i < NUMBERS; i++) {
        const int up = (2 * NUMBERS) + i;
        const int down = (3 * NUMBERS) + i;
        const double moved = (on[up] * l[up]) - (on[down] * l[down]);
        v[i] += (on[i] * l[i]) - (on[NUMBERS + i] * l[NUMBERS + i]) + moved;
        if (i >= COMMANDS) {
            v[i - COMMANDS] -= moved;
        }
    }
    for (k = 0; k < HORIZON; k++) {
        const int numbers = reach_of(k);
        for (i = 0; i < SOFT; i++) {
            const int up = (4 * NUMBERS) + (k * SOFT) + i;
            const int down = (4 * NUMBERS) + ((HORIZON + k) * SOFT) + i;
            const double above = on[up] * l[up];
            const double below = on[down] * l[down];
            const double *const row =
                &c->steep[((k * COLUMNS) + soft_column[i]) * NUMBERS];
            for (n = 0; n < numbers; n++) {
                v[n] += (above - below) * row[n];
            }
            v[NUMBERS + i] -= above + below;
        }
    }
    for (i = 0; i < SOFT; i++) {
        v[NUMBERS + i] -= on[ROWS - SOFT + i] * l[ROWS - SOFT + i];
    }
}

/* Hessian plus rows' weight rows, factorised */
static int factorise_normal(NAME_controller *c)
{
    double *const h = c->factor;
    const double *const on = c->there;
    const double *const w = c->weight;
    int i;
    int j;
    int k;
    int n;
    for (i = 0; i < (VARIABLES * VARIABLES); i++) {
        h[i] = c->hessian[i];
    }
    for (i = 0; i < ROWS; i++) {
        c->weight[i] = c->multipliers[i] / c->slack[i];
    }
    for (i = 0; i < NUMBERS; i++) {
        const int up = (2 * NUMBERS) + i;
        const int down = (3 * NUMBERS) + i;
        const double moved = (on[up] * w[up]) + (on[down] * w[down]);
        const double own = (on[i] * w[i]) + (on[NUMBERS + i] * w[NUMBERS + i]);
        h[(i * VARIABLES) + i] += own + moved;
        if (i >= COMMANDS) {
            const int before = i - COMMANDS;
            h[(before * VARIABLES) + before] += moved;
            h[(i * VARIABLES) + before] -= moved;
        }
    }
    for (k = 0; k < HORIZON; k++) {
        const int numbers = reach_of(k);
        for (i = 0; i < SOFT; i++) {
            const int up = (4 * NUMBERS) + (k * SOFT) + i;
            const int down = (4 * NUMBERS) + ((HORIZON + k) * SOFT) + i;
            const double above = on[up] * w[up];
            const double below = on[down] * w[down];
            const double *const row =
                &c->steep[((k * COLUMNS) + soft_column[i]) * NUMBERS];
            double *const give = &h[(NUMBERS + i) * VARIABLES];
            for (n = 0; n < numbers; n++) {
                const double own = (above + below) * row[n];
                for (j = 0; j <= n; j++) {
                    h[(n * VARIABLES) + j] += own * row[j];
                }
                give[n] -= (above - below) * row[n];
            }
            give[NUMBERS + i] += above + below;
        }
    }
    for (i = 0; i < SOFT; i++) {
        h[((NUMBERS + i) * VARIABLES) + NUMBERS + i] +=
            on[ROWS - SOFT + i] * w[ROWS - SOFT + i];
    }
    return factorise(VARIABLES, h);
}

/* conditions of the optimum; the largest that is left */
static double find_residuals(NAME_controller *c)
{
    double most = 0.0;
    int i;
    int j;
    for (i = 0; i < VARIABLES; i++) {
        double sum = c->gradient[i];
        for (j = 0; j < VARIABLES; j++) {
            sum += c->hessian[(i * VARIABLES) + j] * c->step[j];
        }
        c->dual[i] = sum;
    }
    add_transposed(c, c->multipliers, c->dual);
    multiply_rows(c, c->step, c->primal);
    for (i = 0; i < VARIABLES; i++) {
        most = larger(most, fabs(c->dual[i]));
    }
    for (i = 0; i < ROWS; i++) {
        c->primal[i] += c->slack[i] - c->bound[i];
        most = larger(most, fabs(c->primal[i]));
        most = larger(most, c->slack[i] * c->multipliers[i]);
    }
    return most;
}

/* the step after which slack times multiplier is lower by c->lower */
static void go_towards(NAME_controller *c)
{
    int i;
    for (i = 0; i < ROWS; i++) {
        c->inner[i] = (c->lower[i] / c->slack[i]) - (c->weight[i] * c->primal[i]);
    }
    for (i = 0; i < VARIABLES; i++) {
        c->dz[i] = -c->dual[i];
    }
    add_transposed(c, c->inner, c->dz);
    solve_factors(VARIABLES, c->factor, c->dz);
    multiply_rows(c, c->dz, c->ds);
    for (i = 0; i < ROWS; i++) {
        c->ds[i] = -c->primal[i] - c->ds[i];
        c->dm[i] = -(c->lower[i] + (c->multipliers[i] * c->ds[i])) / c->slack[i];
    }
}

/* how far slacks and multipliers may move before one is zero */
static double find_longest(const NAME_controller *c)
{
    double most = 1.0;
    int i;
    for (i = 0; i < ROWS; i++) {
        if (c->ds[i] < 0.0) {
            most = smaller(most, -c->slack[i] / c->ds[i]);
        }
        if (c->dm[i] < 0.0) {
            most = smaller(most, -c->multipliers[i] / c->dm[i]);
        }
    }
    return most;
}

/* Mehrotra's predictor and corrector, with the factors that are there; the residual */
static double take_step(NAME_controller *c)
{
    double now = 0.0;
    double then = 0.0;
    double length;
    double centre;
    int i;
    for (i = 0; i < ROWS; i++) {
        c->lower[i] = c->slack[i] * c->multipliers[i];
        now += c->lower[i];
    }
    go_towards(c);
    length = find_longest(c);
    for (i = 0; i < ROWS; i++) {
        then += (c->slack[i] + (length * c->ds[i])) *
            (c->multipliers[i] + (length * c->dm[i]));
    }
    centre = then / now;
    centre = centre * centre * centre * (now / (double)ROWS);
    for (i = 0; i < ROWS; i++) {
        c->lower[i] += (c->ds[i] * c->dm[i]) - centre;
    }
    go_towards(c);
    length = find_longest(c);
    length = (length < 1.0) ? (NEAR_BORDER * length) : length;
    for (i = 0; i < VARIABLES; i++) {
        c->step[i] += length * c->dz[i];
    }
    for (i = 0; i < ROWS; i++) {
        c->slack[i] += length * c->ds[i];
        c->multipliers[i] += length * c->dm[i];
    }
    return find_residuals(c);
}

/* the least of the quadratic program, in c->step; the residual that is left. Near it a
   step may fail: what there is stays. */
static double solve_quadratic(NAME_controller *c)
{
    double residual;
    int steps;
    int goes_on;
    int i;
    for (i = 0; i < VARIABLES; i++) {
        c->step[i] = 0.0;
    }
    for (i = 0; i < ROWS; i++) {
        c->slack[i] = larger(c->bound[i], 1.0);
        c->multipliers[i] = 1.0;
    }
    residual = find_residuals(c);
    goes_on = (residual > TOLERANCE) ? 1 : 0;
    for (steps = 0; (goes_on != 0) && (steps < MOST_STEPS); steps++) {
        double next = residual;
        for (i = 0; i < VARIABLES; i++) {
            c->last[i] = c->step[i];
        }
        goes_on = factorise_normal(c);
        if (goes_on != 0) {
            next = take_step(c);
            goes_on = isfinite(next) ? 1 : 0;
        }
        if (goes_on != 0) {
            residual = next;
            goes_on = (residual > TOLERANCE) ? 1 : 0;
        } else {
            for (i = 0; i < VARIABLES; i++) {
                c->step[i] = c->last[i];
            }
        }
    }
    return residual;
}

/* one step of sequential quadratic programming; 0: its program was not solved */
static int improve(NAME_controller *c, const double *reference, const double *given,
    NAME_decision *out)
{
    int solved;
    int i;
    int k;
    for (i = 0; i < NUMBERS; i++) {
        const int own = i % COMMANDS;
        c->z[i] = c->plan[(block_start[i / COMMANDS] * COMMANDS) + own] / span[own];
    }
    linearise(c, given);
    make_objective(c, reference);
    make_bounds(c);
    solved = (solve_quadratic(c) < SOLVED) ? 1 : 0;
    for (i = 0; i < NUMBERS; i++) {
        if (!isfinite(c->step[i])) {
            solved = 0;
        }
    }
    for (i = 0; (i < NUMBERS) && (solved != 0); i++) {
        c->z[i] += c->step[i];
    }
    keep_bounds(c);
    for (k = 0; k < HORIZON; k++) {
        for (i = 0; i < COMMANDS; i++) {
            c->plan[(k * COMMANDS) + i] = command_of(c, k, i);
        }
    }
    for (i = 0; i < LIMITS; i++) {
        const double gives = (solved != 0) ? c->step[NUMBERS + i] : 0.0;
        out->excess[i] = gives * size[soft_column[i]];
    }
    return solved;
}

/* the outputs over the horizon under the plan; 0: one is not finite */
static int look_ahead(NAME_controller *c, double *outputs)
{
    double faded[OUTPUTS];
    int finite = 1;
    int i;
    int k;
    for (i = 0; i < STATES; i++) {
        c->run[i] = c->x[i];
    }
    for (i = 0; i < OUTPUTS; i++) {
        faded[i] = c->fading[i];
    }
    for (k = 0; k < (HORIZON + FIRST); k++) {
        const int at = (k < HORIZON) ? k : (HORIZON - 1);
        for (i = 0; i < COMMANDS; i++) {
            c->now[command_at[i]] = c->plan[(at * COMMANDS) + i];
        }
        for (i = 0; i < GIVEN; i++) {
            c->now[given_at[i]] = c->ahead[(at * GIVEN) + i];
        }
        sample(c->run, c->now, c->next, c->y, c->fed);
        for (i = 0; (i < OUTPUTS) && (k >= FIRST); i++) {
            const double own = c->y[i] + c->offset[i] + faded[i];
            outputs[((k - FIRST) * OUTPUTS) + i] = own;
            finite = isfinite(own) ? finite : 0;
        }
        for (i = 0; i < STATES; i++) {
            c->run[i] = c->next[i];
        }
        for (i = 0; i < OUTPUTS; i++) {
            faded[i] *= pole[i];
        }
    }
    return finite;
}

void NAME_control_step(NAME_controller *c, const double *measured,
    const double *reference, const double *given, NAME_decision *out)
{
    int i;
    int k;
    for (k = 0; k < HORIZON; k++) {
        for (i = 0; i < GIVEN; i++) {
            const double own = given[(k * GIVEN) + i];
            const int there = is_there(own, largest_input[given_at[i]]);
            c->ahead[(k * GIVEN) + i] = (there != 0) ? own : c->u[given_at[i]];
        }
    }
    out->restarted = recover(c, measured);
    correct(c, measured);
    out->solved = 1;
    for (k = 0; k < ROUNDS; k++) {
        if (improve(c, reference, c->ahead, out) == 0) {
            out->solved = 0;
        }
    }
    if (look_ahead(c, out->outputs) == 0) {
        out->solved = 0;
    }
    for (i = 0; i < OUTPUTS; i++) {
        out->disturbance[i] = c->offset[i] + c->fading[i];
    }
    for (i = 0; i < COMMANDS; i++) {
        out->commands[i] = c->plan[i];
        c->u[command_at[i]] = c->plan[i];
    }
    for (i = 0; i < GIVEN; i++) {
        c->u[given_at[i]] = c->ahead[i];
    }
    advance(c);
    for (k = 0; k < (HORIZON - 1); k++) {
        for (i = 0; i < COMMANDS; i++) {
            c->plan[(k * COMMANDS) + i] = c->plan[((k + 1) * COMMANDS) + i];
        }
    }
    for (i = 0; i < USED; i++) {
        c->slow[i] = (fade[i] * c->slow[i]) + ((1.0 - fade[i]) * c->u[used_at[i]]);
    }
}
