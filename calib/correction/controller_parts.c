/* part: api */
#include <math.h>

enum {
    RIG_OK = 0,
    RIG_BAD_POSE = 1,       /* a number of the pose is not finite */
    RIG_OUT_OF_STROKE = 2,  /* a corrected length leaves its strut's range */
    RIG_NOT_CONVERGED = 3,  /* no lengths were found within RIG_ITERATIONS */
    RIG_SENSOR_MISSING = 4, /* channels are absent, or one is not finite */
    RIG_NO_STATE = 5        /* no state, or not finite: the play of a strut depends on it */
};
enum { RIG_ITERATIONS = 100 };

/* Where the struts were commanded to last (m), and where their plays stand (m). */
struct rig_state {
    double command[6], play[6];
};

int rig_start(struct rig_state *state, const double lengths[6]);
int rig_correct(const double pose[6], const double *channels, struct rig_state *state, double lengths[6]);

#define RIG_TOLERANCE 1e-12 /* m, of the last step of an iteration */

struct placed {
    double R[3][3]; /* T_base_platform */
    double p[3];
};

/* part: grid */
struct grid {
    const double *levels[6]; /* cells + 1 of each, ascending, m */
    int cells[6], strides[6];
    const double *values; /* 6 of each vertex, m */
};

/* The lowest vertex of the cell of x, and the place in the cell, 0 to 1; beyond the levels that on their edge. */
static int grid_cell(const struct grid *g, const double x[6], double t[6])
{
    int vertex = 0;
    for (int i = 0; i < 6; i++) {
        const int cells = g->cells[i];
        const double *level = g->levels[i], inner = fmin(fmax(x[i], level[0]), level[cells]);
        int cell = 0;
        for (int j = 1; j < cells; j++)
            cell += inner >= level[j];
        t[i] = (inner - level[cell]) / (level[cell + 1] - level[cell]);
        vertex += cell * g->strides[i];
    }
    return vertex;
}

/* part: simplex */
/* Simplices of a cell: vertices met along the axes, the largest place first (Kuhn, 1960). */
static void add_simplex(const struct grid *g, const double x[6], double weight, double out[6])
{
    double t[6], ranked[7] = {0.0};
    int steps[6] = {0};
    int vertex = grid_cell(g, x, t);
    for (int i = 0; i < 6; i++) {
        int rank = 0;
        for (int j = 0; j < i; j++)
            rank += t[j] >= t[i];
        for (int j = i + 1; j < 6; j++)
            rank += t[j] > t[i];
        ranked[rank] = t[i];
        steps[rank] = g->strides[i];
    }
    for (int k = 0; k < 6; k++)
        out[k] += weight * (1.0 - ranked[0]) * g->values[6 * vertex + k];
    for (int i = 0; i < 6; i++) {
        vertex += steps[i];
        for (int k = 0; k < 6; k++)
            out[k] += weight * (ranked[i] - ranked[i + 1]) * g->values[6 * vertex + k];
    }
}

/* part: linear */
/* Linear along each axis: the 64 vertices of a cell. */
static void add_linear(const struct grid *g, const double x[6], double weight, double out[6])
{
    double t[6];
    const int lowest = grid_cell(g, x, t);
    for (int corner = 0; corner < 64; corner++) {
        int vertex = lowest;
        double share = weight;
        for (int i = 0; i < 6; i++) {
            const int upper = corner >> i & 1;
            vertex += upper * g->strides[i];
            share *= upper ? t[i] : 1.0 - t[i];
        }
        for (int k = 0; k < 6; k++)
            out[k] += share * g->values[6 * vertex + k];
    }
}

/* part: axes */
struct axis_sum {
    int count;
    const double *knots;        /* count of each axis */
    const double *coefficients; /* 6 of each knot, axis after axis */
};

/* A sum of one piecewise linear function per axis. */
static void add_axes(const struct axis_sum *f, const double x[6], double weight, double out[6])
{
    for (int i = 0; i < 6; i++) {
        const double *knots = f->knots + i * f->count;
        const double inner = fmin(fmax(x[i], knots[0]), knots[f->count - 1]);
        int cell = 0;
        for (int j = 1; j < f->count - 1; j++)
            cell += inner >= knots[j];
        const double t = (inner - knots[cell]) / (knots[cell + 1] - knots[cell]);
        const double *low = f->coefficients + 6 * (i * f->count + cell);
        for (int k = 0; k < 6; k++)
            out[k] += weight * ((1.0 - t) * low[k] + t * low[6 + k]);
    }
}

/* part: polynomial */
struct polynomial {
    int terms;
    const double *low, *high;
    const int *powers;          /* 6 of each term */
    const double *coefficients; /* 6 of each term */
};

/* A polynomial of coordinates that go from -1 to 1 over the box of the samples. */
static void add_polynomial(const struct polynomial *f, const double x[6], double weight, double out[6])
{
    double u[6];
    for (int i = 0; i < 6; i++) {
        const double inner = fmin(fmax(x[i], f->low[i]), f->high[i]);
        u[i] = (2.0 * inner - f->low[i] - f->high[i]) / (f->high[i] - f->low[i]);
    }
    for (int term = 0; term < f->terms; term++) {
        double product = weight;
        for (int i = 0; i < 6; i++)
            for (int power = f->powers[6 * term + i]; power > 0; power--)
                product *= u[i];
        for (int k = 0; k < 6; k++)
            out[k] += product * f->coefficients[6 * term + k];
    }
}

/* part: radial */
struct radial {
    int axis, count;
    double own, whole; /* 1 / (2 length^2), in half strokes, of the function of the axis and of that of all */
    const double *centre, *half;
    const double *samples; /* of each its scaled configuration, and its weight in either function (m) */
};

/* A Gaussian process: a sum over its samples. */
static void add_radial(const struct radial *f, const double x[6], double weight, double out[6])
{
    double scaled[6], sum = 0.0;
    for (int i = 0; i < 6; i++)
        scaled[i] = (x[i] - f->centre[i]) / f->half[i];
    for (int n = 0; n < f->count; n++) {
        const double *sample = f->samples + 8 * n;
        const double off = scaled[f->axis] - sample[f->axis];
        double square = 0.0;
        for (int i = 0; i < 6; i++)
            square += (scaled[i] - sample[i]) * (scaled[i] - sample[i]);
        sum += sample[6] * exp(-f->own * off * off) + sample[7] * exp(-f->whole * square);
    }
    out[f->axis] += weight * sum;
}

/* part: within */
/* 1 within a part of the space, 0 far from it, fading between. */
static double within(const double x[6], const double low[6], const double high[6], const double fade[6])
{
    double weight = 1.0;
    for (int i = 0; i < 6; i++) {
        const double far = fmin(fmax(fmax(low[i] - x[i], x[i] - high[i]), 0.0) / fade[i], 1.0);
        weight *= (1.0 - far) * (1.0 - far) * (1.0 + 2.0 * far);
    }
    return weight;
}

/* part: no remainder */
static int settle(const double goal[6], double effective[6])
{
    for (int i = 0; i < 6; i++)
        effective[i] = goal[i];
    return RIG_OK;
}

/* part: settle */
/* Lengths with effective = goal + remainder(effective), m. */
static int settle(const double goal[6], double effective[6])
{
    for (int i = 0; i < 6; i++)
        effective[i] = goal[i];
    for (int n = 0; n < RIG_ITERATIONS; n++) {
        double rest[6] = {0.0}, change = 0.0;
        add_remainder(effective, rest);
        for (int i = 0; i < 6; i++) {
            const double next = goal[i] + rest[i];
            change = fmax(change, fabs(next - effective[i]));
            effective[i] = next;
        }
        if (change < RIG_TOLERANCE)
            return RIG_OK;
    }
    return RIG_NOT_CONVERGED;
}

/* part: rotation */
/* Rotation matrix of a rotation vector, rad (Rodrigues). */
static void rotation(const double v[3], double R[3][3])
{
    const double square = v[0] * v[0] + v[1] * v[1] + v[2] * v[2], angle = sqrt(square);
    const double a = angle > 1e-4 ? sin(angle) / angle : 1.0 - square / 6.0 * (1.0 - square / 20.0);
    const double half = angle > 1e-4 ? sin(0.5 * angle) / angle : 0.5 * (1.0 - square / 24.0);
    const double b = 2.0 * half * half;
    const double cross[3][3] = {{0.0, -v[2], v[1]}, {v[2], 0.0, -v[0]}, {-v[1], v[0], 0.0}};
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            R[i][j] = a * cross[i][j] + b * v[i] * v[j] + (i == j ? 1.0 - b * square : 0.0);
}

/* part: pose maps */
/* Rotation vector (rad) of a rotation matrix, by its unit quaternion. */
static void rotation_vector(double R[3][3], double v[3])
{
    const double trace = R[0][0] + R[1][1] + R[2][2];
    double q[4], best = trace; /* x y z w */
    int most = 3;
    for (int i = 0; i < 3; i++)
        if (R[i][i] > best) {
            best = R[i][i];
            most = i;
        }
    if (most == 3) {
        q[0] = R[2][1] - R[1][2];
        q[1] = R[0][2] - R[2][0];
        q[2] = R[1][0] - R[0][1];
        q[3] = 1.0 + trace;
    } else {
        const int j = (most + 1) % 3, k = (most + 2) % 3;
        q[most] = 1.0 - trace + 2.0 * R[most][most];
        q[j] = R[j][most] + R[most][j];
        q[k] = R[k][most] + R[most][k];
        q[3] = R[k][j] - R[j][k];
    }
    const double sign = q[3] < 0.0 ? -1.0 : 1.0, norm = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    const double sine = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2]) / norm;
    const double scale = sine > 0.0 ? 2.0 * atan2(sine, sign * q[3] / norm) / sine : 2.0;
    for (int i = 0; i < 3; i++)
        v[i] = scale * sign * q[i] / norm;
}

/* T exp(-xi), xi a tangent of translation (m) and rotation (rad) on the right. */
static void moved_back(const struct placed *T, const double xi[6], struct placed *out)
{
    const double v[3] = {-xi[3], -xi[4], -xi[5]}, u[3] = {-xi[0], -xi[1], -xi[2]};
    const double square = v[0] * v[0] + v[1] * v[1] + v[2] * v[2], angle = sqrt(square);
    const double half = angle > 1e-4 ? sin(0.5 * angle) / angle : 0.5 * (1.0 - square / 24.0);
    const double b = 2.0 * half * half;
    const double c = angle > 1e-2 ? (1.0 - sin(angle) / angle) / square
                                  : (1.0 - square / 20.0 * (1.0 - square / 42.0)) / 6.0;
    const double once[3] = {v[1] * u[2] - v[2] * u[1], v[2] * u[0] - v[0] * u[2], v[0] * u[1] - v[1] * u[0]};
    const double twice[3] = {v[1] * once[2] - v[2] * once[1], v[2] * once[0] - v[0] * once[2],
                             v[0] * once[1] - v[1] * once[0]};
    struct placed next;
    double turn[3][3];
    rotation(v, turn);
    for (int i = 0; i < 3; i++) {
        next.p[i] = T->p[i];
        for (int j = 0; j < 3; j++) {
            next.p[i] += T->R[i][j] * (u[j] + b * once[j] + c * twice[j]);
            next.R[i][j] = 0.0;
            for (int k = 0; k < 3; k++)
                next.R[i][j] += T->R[i][k] * turn[k][j];
        }
    }
    *out = next;
}

/* The pose at which the machine is to be taken to stand, for a map in pose space: T' = T exp(-error(T')). */
static int compensate(void (*add)(const double *, double, double *), const double home[3][3], struct placed *T)
{
    struct placed found = *T;
    double before[6] = {0.0};
    for (int n = 0; n < RIG_ITERATIONS / 2; n++) {
        double at[6], turn[3][3], error[6] = {0.0}, change = 0.0;
        for (int i = 0; i < 3; i++) {
            at[i] = found.p[i];
            for (int j = 0; j < 3; j++) {
                turn[i][j] = 0.0;
                for (int k = 0; k < 3; k++)
                    turn[i][j] += home[k][i] * found.R[k][j];
            }
        }
        rotation_vector(turn, at + 3);
        add(at, 1.0, error);
        for (int i = 0; i < 6; i++) {
            change = fmax(change, fabs(error[i] - before[i]));
            before[i] = error[i];
        }
        moved_back(T, error, &found);
        if (change < 1e-13) {
            *T = found;
            return RIG_OK;
        }
    }
    return RIG_NOT_CONVERGED;
}

/* part: no effects */
static int command(const double effective[6], const double tip[6][3], const double *channels,
                   struct rig_state *state, double lengths[6])
{
    (void)tip;
    (void)channels;
    (void)state;
    for (int i = 0; i < 6; i++)
        lengths[i] = effective[i];
    return RIG_OK;
}

/* part: effects */
/* Commands (m) that become effective lengths (m): effects undone, plays taken up from where they stand. */
static int command(const double effective[6], const double tip[6][3], const double *channels,
                   struct rig_state *state, double lengths[6])
{
    for (int i = 0; i < 6; i++) {
        lengths[i] = effective[i];
        if (GAP[i] > 0.0 && (!state || !isfinite(state->play[i]) || !isfinite(state->command[i])))
            return RIG_NO_STATE;
    }
    for (int k = 0; k < RIG_CHANNELS; k++)
        if (!channels || !isfinite(channels[k]))
            return RIG_SENSOR_MISSING;
    for (int n = 0; n < RIG_ITERATIONS; n++) {
        double d[6] = {0.0}, change = 0.0;
        add_deviations(lengths, tip, channels, d);
        for (int i = 0; i < 6; i++) {
            double next = effective[i] - d[i];
            if (GAP[i] > 0.0) {
                const double off = next - state->play[i];
                if (fabs(off) < 1e-10) /* m, as `rig correct`: the strut stands where it is to stand */
                    next = state->command[i];
                else
                    next += off > 0.0 ? 0.5 * GAP[i] : -0.5 * GAP[i];
            }
            change = fmax(change, fabs(next - lengths[i]));
            lengths[i] = next;
        }
        if (change < RIG_TOLERANCE)
            return RIG_OK;
    }
    return RIG_NOT_CONVERGED;
}

/* part: correct */
int rig_start(struct rig_state *state, const double lengths[6])
{
    for (int i = 0; i < 6; i++) {
        if (!state)
            return RIG_NO_STATE;
        state->command[i] = state->play[i] = lengths ? lengths[i] : rig_home[i];
        if (!isfinite(state->play[i]))
            return RIG_NO_STATE;
    }
    return RIG_OK;
}

int rig_correct(const double pose[6], const double *channels, struct rig_state *state, double lengths[6])
{
    struct placed T;
    double tip[6][3], goal[6], effective[6], found[6];
    int status = RIG_OK;
    for (int i = 0; i < 6; i++)
        if (!isfinite(pose[i]))
            return RIG_BAD_POSE;
    for (int i = 0; i < 3; i++)
        T.p[i] = pose[i];
    rotation(pose + 3, T.R);
    /* insert: pose maps */
    for (int i = 0; i < 6; i++) {
        double square = 0.0;
        for (int k = 0; k < 3; k++) {
            tip[i][k] = T.p[k];
            for (int j = 0; j < 3; j++)
                tip[i][k] += T.R[k][j] * PLATFORM[i][j];
            square += (tip[i][k] - BASE[i][k]) * (tip[i][k] - BASE[i][k]);
        }
        goal[i] = sqrt(square) - ZERO[i];
    }
    status = settle(goal, effective);
    if (status == RIG_OK)
        status = command(effective, (const double(*)[3])tip, channels, state, found);
    if (status != RIG_OK)
        return status;
    for (int i = 0; i < 6; i++)
        if (!(found[i] >= RANGE[i][0] && found[i] <= RANGE[i][1]))
            return RIG_OUT_OF_STROKE;
    for (int i = 0; i < 6; i++) {
        lengths[i] = found[i];
        if (state) {
            state->play[i] = fmin(fmax(state->play[i], found[i] - 0.5 * GAP[i]), found[i] + 0.5 * GAP[i]);
            state->command[i] = found[i];
        }
    }
    return RIG_OK;
}
