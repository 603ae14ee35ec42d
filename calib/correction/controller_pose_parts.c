/* part: pose kinematics */
enum { RIG_SINGULAR = 6 }; /* too near a singularity, or an assembly that is not that of home */
enum { RIG_NEWTON_STEPS = 30 };

#define RIG_CLOSE 1e-11 /* m, of the struts at the pose that forward kinematics finds */

static const char *const REFUSALS[] = {
    "", "a number is not finite", "a strut leaves its range", "no solution within the bounded iterations",
    "a sensor is not finite", "play without a state", "too near a singularity, or assembled otherwise than at home",
};

/* T_base_platform of X Y Z in machine units and A B C in degrees: turns about fixed x, y and z, in this order. */
static int placed_at(const double world[6], struct placed *T)
{
    const double turn = atan(1.0) / 45.0;
    const double sa = sin(world[3] * turn), ca = cos(world[3] * turn), sb = sin(world[4] * turn);
    const double cb = cos(world[4] * turn), sc = sin(world[5] * turn), cc = cos(world[5] * turn);
    const double R[3][3] = {{cb * cc, sa * sb * cc - ca * sc, ca * sb * cc + sa * sc},
                            {cb * sc, sa * sb * sc + ca * cc, ca * sb * sc - sa * cc},
                            {-sb, sa * cb, ca * cb}};
    for (int i = 0; i < 3; i++) {
        T->p[i] = world[i] / UNITS;
        if (!isfinite(T->p[i]))
            return RIG_BAD_POSE;
        for (int j = 0; j < 3; j++) {
            T->R[i][j] = R[i][j];
            if (!isfinite(R[i][j]))
                return RIG_BAD_POSE;
        }
    }
    return RIG_OK;
}

/* The turn (degrees) nearest to a previous one that is a found one but for whole turns. */
static double nearest(double found, double previous)
{
    return isfinite(previous) ? found + 360.0 * floor((previous - found) / 360.0 + 0.5) : found;
}

static void world_of(const struct placed *T, double world[6])
{
    const double turn = atan(1.0) / 45.0;
    const double b = atan2(-T->R[2][0], sqrt(T->R[0][0] * T->R[0][0] + T->R[1][0] * T->R[1][0])) / turn;
    for (int i = 0; i < 3; i++)
        world[i] = T->p[i] * UNITS;
    world[3] = nearest(atan2(T->R[2][1], T->R[2][2]) / turn, world[3]);
    world[4] = nearest(b, world[4]);
    world[5] = nearest(atan2(T->R[1][0], T->R[0][0]) / turn, world[5]);
}

/* Change of the lengths with a shift (m) and with a turn about the platform's origin (m at LEVER), base frame. */
static void jacobian(const struct placed *T, const double tip[6][3], double J[6][6])
{
    for (int i = 0; i < 6; i++) {
        double u[3], arm[3], length = 0.0;
        for (int k = 0; k < 3; k++) {
            u[k] = tip[i][k] - BASE[i][k];
            arm[k] = (tip[i][k] - T->p[k]) / LEVER;
            length += u[k] * u[k];
        }
        length = sqrt(length);
        for (int k = 0; k < 3; k++)
            J[i][k] = u[k] / length;
        for (int k = 0; k < 3; k++)
            J[i][3 + k] = arm[(k + 1) % 3] * J[i][(k + 2) % 3] - arm[(k + 2) % 3] * J[i][(k + 1) % 3];
    }
}

/* Solve J x = b by elimination with pivots, x in place of b; returns the determinant, 0 or NaN where there is none. */
static double solve(double J[6][6], double b[6])
{
    double determinant = 1.0;
    for (int k = 0; k < 6; k++) {
        int best = k;
        for (int i = k + 1; i < 6; i++)
            if (fabs(J[i][k]) > fabs(J[best][k]))
                best = i;
        if (!(fabs(J[best][k]) > 0.0))
            return 0.0;
        for (int j = 0; j < 6; j++) {
            const double swap = J[k][j];
            J[k][j] = J[best][j];
            J[best][j] = swap;
        }
        const double moved = b[k];
        b[k] = b[best];
        b[best] = moved;
        determinant *= best == k ? J[k][k] : -J[k][k];
        for (int i = k + 1; i < 6; i++) {
            const double share = J[i][k] / J[k][k];
            for (int j = k; j < 6; j++)
                J[i][j] -= share * J[k][j];
            b[i] -= share * b[k];
        }
    }
    for (int k = 5; k >= 0; k--) {
        for (int j = k + 1; j < 6; j++)
            b[k] -= J[k][j] * b[j];
        b[k] /= J[k][k];
    }
    return determinant;
}

/* Whether the least singular value of J is above LEAST and its determinant has the sign of home: J'J - LEAST^2 I has a
   Cholesky factor. */
static int is_regular(double J[6][6])
{
    double L[6][6], nothing[6] = {0.0};
    for (int i = 0; i < 6; i++)
        for (int j = 0; j <= i; j++) {
            double sum = i == j ? -LEAST * LEAST : 0.0;
            for (int k = 0; k < 6; k++)
                sum += J[k][i] * J[k][j];
            for (int k = 0; k < j; k++)
                sum -= L[i][k] * L[j][k];
            if (i == j && !(sum > 0.0))
                return 0;
            L[i][j] = i == j ? sqrt(sum) : sum / L[j][j];
        }
    return solve(J, nothing) * HANDED > 0.0;
}

/* The pose at which corrected lengths are those given (m), by Newton's method from T. */
static int forward(const double lengths[6], const double *channels, struct placed *T, int *steps)
{
    for (int n = 0; n < RIG_NEWTON_STEPS; n++) {
        double tip[6][3], found[6], off[6], J[6][6], turn[3], R[3][3], most = 0.0, stroke = 0.0;
        struct placed next;
        const int status = corrected(T, channels, 0, tip, found);
        if (status != RIG_OK)
            return status;
        for (int i = 0; i < 6; i++) {
            off[i] = lengths[i] - found[i];
            most = fmax(most, fabs(off[i]));
            stroke = fmax(stroke, RANGE[i][1] - RANGE[i][0]);
        }
        jacobian(T, (const double(*)[3])tip, J);
        if (most < RIG_CLOSE)
            return is_regular(J) ? RIG_OK : RIG_SINGULAR;
        if (!(most < 2.0 * stroke) || solve(J, off) == 0.0)
            return RIG_NOT_CONVERGED;
        for (int k = 0; k < 3; k++)
            turn[k] = off[3 + k] / LEVER;
        const double angle = sqrt(turn[0] * turn[0] + turn[1] * turn[1] + turn[2] * turn[2]);
        const double share = angle > 0.4 ? 0.4 / angle : 1.0; /* rad: a step does not leap into another assembly */
        for (int k = 0; k < 3; k++)
            turn[k] *= share;
        rotation(turn, R);
        for (int i = 0; i < 3; i++) {
            next.p[i] = T->p[i] + share * off[i];
            for (int j = 0; j < 3; j++) {
                next.R[i][j] = 0.0;
                for (int k = 0; k < 3; k++)
                    next.R[i][j] += R[i][k] * T->R[k][j];
            }
        }
        *T = next;
        *steps += 1;
    }
    return RIG_NOT_CONVERGED;
}

/* Corrected lengths (m) of a pose, machine units and degrees, and 0; else a status, and the first strut beyond its range
   or 0. */
static int lengths_of(const double world[6], const double *channels, double lengths[6], int *strut)
{
    struct placed T;
    double tip[6][3], J[6][6];
    int status = placed_at(world, &T);
    *strut = 0;
    if (status == RIG_OK)
        status = corrected(&T, channels, 0, tip, lengths);
    if (status != RIG_OK)
        return status;
    *strut = axis_beyond_range(lengths);
    if (*strut)
        return RIG_OUT_OF_STROKE;
    jacobian(&T, (const double(*)[3])tip, J);
    return is_regular(J) ? RIG_OK : RIG_SINGULAR;
}

/* The pose of corrected lengths (m), from the pose given or else from home; else a status, and the pose as it was.
   Lengths beyond their ranges have a pose too: an operator has to see it. */
static int pose_of(const double lengths[6], const double *channels, double world[6], int *steps)
{
    struct placed T;
    int status = RIG_BAD_POSE;
    *steps = 0;
    for (int i = 0; i < 6; i++)
        if (!isfinite(lengths[i]))
            return RIG_BAD_POSE;
    if (placed_at(world, &T) == RIG_OK)
        status = forward(lengths, channels, &T, steps);
    if (status != RIG_OK && status != RIG_SENSOR_MISSING) {
        T = HOME_POSE;
        status = forward(lengths, channels, &T, steps);
    }
    if (status == RIG_OK)
        world_of(&T, world);
    return status;
}
