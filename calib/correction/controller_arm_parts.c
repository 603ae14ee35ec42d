/* part: arm */
/* Links of an arm: theta, d, a, alpha, beta of each (rad, m), before them its base, behind them its tool. */
struct chain {
    double rows[RIG_AXES][5];
    struct placed base, tool;
};

/* part: profile */
/* What a joint falls short of its command (rad): waves of its own angle, and the other joints' angles. */
struct profile {
    int axis, count;
    const double *orders; /* waves a turn, count of them */
    const double *own;    /* sine and cosine of each */
    const double *others; /* sine and cosine of each joint */
};

static void add_profile(const struct profile *f, const double *x, double weight, double *out)
{
    double sum = 0.0;
    for (int k = 0; k < f->count; k++) {
        const double angle = f->orders[k] * x[f->axis];
        sum += f->own[2 * k] * sin(angle) + f->own[2 * k + 1] * cos(angle);
    }
    for (int i = 0; i < RIG_AXES; i++)
        sum += f->others[2 * i] * sin(x[i]) + f->others[2 * i + 1] * cos(x[i]);
    out[f->axis] += weight * sum;
}

/* part: arm kinematics */
static void append(struct placed *T, const struct placed *next)
{
    const struct placed at = *T;
    for (int i = 0; i < 3; i++) {
        T->p[i] = at.p[i];
        for (int j = 0; j < 3; j++) {
            T->p[i] += at.R[i][j] * next->p[j];
            T->R[i][j] = 0.0;
            for (int k = 0; k < 3; k++)
                T->R[i][j] += at.R[i][k] * next->R[k][j];
        }
    }
}

/* Pose of the tool at joint values q (rad, of slides m); z, o : direction and origin (m) of each axis. */
static void forward(const struct chain *arm, const double q[RIG_AXES], double z[RIG_AXES][3], double o[RIG_AXES][3],
                    struct placed *T)
{
    *T = arm->base;
    for (int i = 0; i < RIG_AXES; i++) {
        const double *row = arm->rows[i], theta = row[0] + (SLIDES[i] ? 0.0 : q[i]);
        const double ct = cos(theta), st = sin(theta), ca = cos(row[3]), sa = sin(row[3]);
        const double cb = cos(row[4]), sb = sin(row[4]);
        const struct placed link = {
            {{ct * cb - st * sa * sb, -st * ca, ct * sb + st * sa * cb},
             {st * cb + ct * sa * sb, ct * ca, st * sb - ct * sa * cb},
             {-ca * sb, sa, ca * cb}},
            {row[2] * ct, row[2] * st, row[1] + (SLIDES[i] ? q[i] : 0.0)}};
        for (int k = 0; k < 3; k++) {
            z[i][k] = T->R[k][2];
            o[i][k] = T->p[k];
        }
        append(T, &link);
    }
    append(T, &arm->tool);
}

/* What is missing to T at joint values q, m and rad in the hand; J : how the hand moves with the joints. */
static void missing(const struct placed *T, const double q[RIG_AXES], double e[6], double J[6][RIG_AXES])
{
    double z[RIG_AXES][3], o[RIG_AXES][3], turn[3][3];
    struct placed at;
    forward(&FITTED, q, z, o, &at);
    for (int i = 0; i < 3; i++) {
        e[i] = 0.0;
        for (int k = 0; k < 3; k++)
            e[i] += at.R[k][i] * (T->p[k] - at.p[k]);
        for (int j = 0; j < 3; j++) {
            turn[i][j] = 0.0;
            for (int k = 0; k < 3; k++)
                turn[i][j] += at.R[k][i] * T->R[k][j];
        }
    }
    rotation_vector(turn, e + 3);
    for (int n = 0; n < RIG_AXES; n++) {
        const double r[3] = {at.p[0] - o[n][0], at.p[1] - o[n][1], at.p[2] - o[n][2]}, *u = z[n];
        const double v[3] = {u[1] * r[2] - u[2] * r[1], u[2] * r[0] - u[0] * r[2], u[0] * r[1] - u[1] * r[0]};
        for (int i = 0; i < 3; i++) {
            J[i][n] = J[3 + i][n] = 0.0;
            for (int k = 0; k < 3; k++) {
                J[i][n] += at.R[k][i] * (SLIDES[n] ? u[k] : v[k]);
                J[3 + i][n] += SLIDES[n] ? 0.0 : at.R[k][i] * u[k];
            }
        }
    }
}

static double norm3(const double v[3])
{
    return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
}

/* part: arm of six joints or more */
/* Step x of the joints that makes up for e, damped: J' (J J' + damping)^-1 e, by Cholesky's method. */
static int damped_step(const double J[6][RIG_AXES], const double e[6], double damping, double x[RIG_AXES])
{
    double L[6][6], y[6];
    for (int i = 0; i < 6; i++)
        for (int j = 0; j <= i; j++) {
            double sum = i == j ? damping : 0.0;
            for (int n = 0; n < RIG_AXES; n++)
                sum += J[i][n] * J[j][n];
            for (int k = 0; k < j; k++)
                sum -= L[i][k] * L[j][k];
            if (i == j && !(sum > 0.0))
                return RIG_NOT_CONVERGED;
            L[i][j] = i == j ? sqrt(sum) : sum / L[j][j];
        }
    for (int i = 0; i < 6; i++) {
        y[i] = e[i];
        for (int k = 0; k < i; k++)
            y[i] -= L[i][k] * y[k];
        y[i] /= L[i][i];
    }
    for (int i = 5; i >= 0; i--) {
        for (int k = i + 1; k < 6; k++)
            y[i] -= L[k][i] * y[k];
        y[i] /= L[i][i];
    }
    for (int n = 0; n < RIG_AXES; n++) {
        x[n] = 0.0;
        for (int i = 0; i < 6; i++)
            x[n] += J[i][n] * y[i];
    }
    return RIG_OK;
}

enum { RIG_STEPS = 40 };
#define RIG_MET 1e-11 /* m and rad, of the pose; from a hundredth of it on nothing is improved */

/* Joint values of the fitted arm that give T, from q on by damped steps of 0.3 rad or m at most, as `rig correct`. */
static int solve(const struct placed *T, double q[RIG_AXES])
{
    double at[RIG_AXES], least = HUGE_VAL;
    for (int i = 0; i < RIG_AXES; i++)
        at[i] = q[i];
    for (int n = 0; n < RIG_STEPS; n++) {
        double e[6], J[6][RIG_AXES], x[RIG_AXES], longest = 0.0;
        missing(T, at, e, J);
        const double size = fmax(norm3(e), norm3(e + 3));
        if (size < least) {
            least = size;
            for (int i = 0; i < RIG_AXES; i++)
                q[i] = at[i];
        }
        if (least < 0.01 * RIG_MET)
            return RIG_OK;
        if (damped_step((const double(*)[RIG_AXES])J, e, size * size + 1e-14, x) != RIG_OK)
            return RIG_NOT_CONVERGED;
        for (int i = 0; i < RIG_AXES; i++)
            longest = fmax(longest, fabs(x[i]));
        for (int i = 0; i < RIG_AXES; i++)
            at[i] += x[i] / fmax(1.0, longest / 0.3);
    }
    return least < RIG_MET ? RIG_OK : RIG_NOT_CONVERGED;
}

/* part: arm of few joints */
/* Step of the joints by which A makes up for e in its `count` best directions, damped; V : these, in the joints.
   Singular values by rotations of rows (Hestenes 1958), of which three sweep to rounding within the bound. */
static void led(const double A[3][RIG_AXES], const double e[3], int count, double step[RIG_AXES],
                double V[3][RIG_AXES])
{
    double B[3][RIG_AXES], along[3], squares[3], damping = 1e-15;
    int rank[3];
    for (int i = 0; i < 3; i++) {
        along[i] = e[i];
        for (int n = 0; n < RIG_AXES; n++)
            B[i][n] = A[i][n];
    }
    for (int sweep = 0; sweep < 12; sweep++)
        for (int p = 0; p < 2; p++)
            for (int q = p + 1; q < 3; q++) {
                double pp = 0.0, qq = 0.0, pq = 0.0;
                for (int n = 0; n < RIG_AXES; n++) {
                    pp += B[p][n] * B[p][n];
                    qq += B[q][n] * B[q][n];
                    pq += B[p][n] * B[q][n];
                }
                if (fabs(pq) <= 1e-18 * sqrt(pp * qq))
                    continue;
                const double zeta = (qq - pp) / (2.0 * pq);
                const double t = (zeta < 0.0 ? -1.0 : 1.0) / (fabs(zeta) + sqrt(1.0 + zeta * zeta));
                const double c = 1.0 / sqrt(1.0 + t * t), s = c * t;
                for (int n = 0; n < RIG_AXES; n++) {
                    const double b = B[p][n];
                    B[p][n] = c * b - s * B[q][n];
                    B[q][n] = s * b + c * B[q][n];
                }
                const double a = along[p];
                along[p] = c * a - s * along[q];
                along[q] = s * a + c * along[q];
            }
    for (int i = 0; i < 3; i++) {
        squares[i] = 0.0;
        for (int n = 0; n < RIG_AXES; n++)
            squares[i] += B[i][n] * B[i][n];
    }
    for (int i = 0; i < 3; i++) {
        rank[i] = 0;
        for (int j = 0; j < 3; j++)
            rank[i] += squares[j] > squares[i] || (squares[j] == squares[i] && j < i);
        damping += rank[i] < count ? 0.5 * along[i] * along[i] : 0.0;
    }
    for (int n = 0; n < RIG_AXES; n++)
        step[n] = 0.0;
    for (int i = 0; i < 3; i++)
        for (int n = 0; n < RIG_AXES; n++) {
            const int used = rank[i] < count && squares[i] > 0.0;
            V[i][n] = used ? B[i][n] / sqrt(squares[i]) : 0.0;
            step[n] += used ? B[i][n] * along[i] / (squares[i] + damping) : 0.0;
        }
}

enum { RIG_STEPS = 80 };
#define RIG_MET 1e-10  /* m, of a position that the arm can take anywhere */
#define RIG_NEAR 0.05 /* m and rad, of what few joints may leave */

/* Joint values of the fitted arm nearest to T, from q on: position first, rotation by motions that keep it. */
static int solve(const struct placed *T, double q[RIG_AXES])
{
    double e[6], J[6][RIG_AXES], size = HUGE_VAL;
    for (int k = 0; k < RIG_STEPS && size >= RIG_TOLERANCE; k++) {
        double step[RIG_AXES], V[3][RIG_AXES], turned[3][RIG_AXES], left[3], more[RIG_AXES], unused[3][RIG_AXES];
        missing(T, q, e, J);
        led((const double(*)[RIG_AXES])J, e, POSITIONS, step, V);
        for (int i = 0; i < 3; i++) {
            left[i] = e[3 + i];
            for (int n = 0; n < RIG_AXES; n++) {
                left[i] -= J[3 + i][n] * step[n];
                turned[i][n] = J[3 + i][n];
            }
            for (int m = 0; m < 3; m++) {
                double share = 0.0;
                for (int n = 0; n < RIG_AXES; n++)
                    share += J[3 + i][n] * V[m][n];
                for (int n = 0; n < RIG_AXES; n++)
                    turned[i][n] -= share * V[m][n];
            }
        }
        led((const double(*)[RIG_AXES])turned, left, ROTATIONS, more, unused);
        size = 0.0;
        for (int n = 0; n < RIG_AXES; n++)
            size = fmax(size, fabs(step[n] + more[n]));
        for (int n = 0; n < RIG_AXES; n++)
            q[n] += (step[n] + more[n]) / fmax(1.0, size / 0.5);
    }
    missing(T, q, e, J);
    const int met = norm3(e) <= (POSITIONS == 3 ? RIG_MET : RIG_NEAR) && norm3(e + 3) <= RIG_NEAR;
    return size < RIG_TOLERANCE && met ? RIG_OK : RIG_NOT_CONVERGED;
}

/* part: arm correct */
int rig_correct(const double joints[RIG_AXES], const double *channels, struct rig_state *state,
                double commands[RIG_AXES])
{
    double z[RIG_AXES][3], o[RIG_AXES][3], goal[RIG_AXES], effective[RIG_AXES], found[RIG_AXES];
    struct placed T;
    for (int i = 0; i < RIG_AXES; i++) {
        if (!isfinite(joints[i]))
            return RIG_BAD_POSE;
        goal[i] = joints[i];
    }
    forward(&NOMINAL, joints, z, o, &T);
    int status = solve(&T, goal);
    if (status == RIG_OK)
        status = settle(goal, effective);
    if (status == RIG_OK)
        status = command(effective, 0, channels, state, found);
    return status == RIG_OK ? commanded(found, state, commands) : status;
}
