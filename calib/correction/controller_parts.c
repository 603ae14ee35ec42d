/* part: api */
#include <math.h>

enum {
    RIG_OK = 0,
    RIG_BAD_POSE = 1,       /* a number of what is wanted is not finite */
    RIG_OUT_OF_STROKE = 2,  /* a corrected command leaves its axis' range */
    RIG_NOT_CONVERGED = 3,  /* no commands were found within RIG_ITERATIONS */
    RIG_SENSOR_MISSING = 4, /* channels are absent, or one is not finite */
    RIG_NO_STATE = 5        /* no state, or not finite: the play of an axis depends on it */
};
enum { RIG_ITERATIONS = 100 };

/* Where the axes were commanded to last, and where their plays stand, m or rad. */
struct rig_state {
    double command[RIG_AXES], play[RIG_AXES];
};

int rig_start(struct rig_state *state, const double commands[RIG_AXES]);
int rig_correct(const double wanted[RIG_AXES], const double *channels, struct rig_state *state,
                double commands[RIG_AXES]);

#define RIG_TOLERANCE 1e-12 /* m or rad, of the last step of an iteration */

struct placed {
    double R[3][3]; /* T_base_platform */
    double p[3];
};

/* part: no remainder */
static int settle(const double goal[RIG_AXES], double effective[RIG_AXES])
{
    for (int i = 0; i < RIG_AXES; i++)
        effective[i] = goal[i];
    return RIG_OK;
}

/* part: settle */
/* Commands with effective = goal + remainder(effective), m or rad. */
static int settle(const double goal[RIG_AXES], double effective[RIG_AXES])
{
    for (int i = 0; i < RIG_AXES; i++)
        effective[i] = goal[i];
    for (int n = 0; n < RIG_ITERATIONS; n++) {
        double rest[RIG_AXES] = {0.0}, change = 0.0;
        add_remainder(effective, rest);
        for (int i = 0; i < RIG_AXES; i++) {
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

/* part: rotation vector */
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

/* part: pose maps */
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
static int command(const double effective[RIG_AXES], const double tip[6][3], const double *channels,
                   struct rig_state *state, double lengths[RIG_AXES])
{
    (void)tip;
    (void)channels;
    (void)state;
    for (int i = 0; i < RIG_AXES; i++)
        lengths[i] = effective[i];
    return RIG_OK;
}

/* part: effects */
/* Commands that become effective ones, m or rad: effects undone, plays taken up from where they stand. */
static int command(const double effective[RIG_AXES], const double tip[6][3], const double *channels,
                   struct rig_state *state, double lengths[RIG_AXES])
{
    for (int i = 0; i < RIG_AXES; i++) {
        lengths[i] = effective[i];
        if (GAP[i] > 0.0 && (!state || !isfinite(state->play[i]) || !isfinite(state->command[i])))
            return RIG_NO_STATE;
    }
    for (int k = 0; k < RIG_CHANNELS; k++)
        if (!channels || !isfinite(channels[k]))
            return RIG_SENSOR_MISSING;
    for (int n = 0; n < RIG_ITERATIONS; n++) {
        double d[RIG_AXES] = {0.0}, change = 0.0;
        add_deviations(lengths, tip, channels, d);
        for (int i = 0; i < RIG_AXES; i++) {
            double next = effective[i] - d[i];
            if (GAP[i] > 0.0) {
                const double off = next - state->play[i];
                if (fabs(off) < 1e-10) /* as `rig correct`: the axis stands where it is to stand */
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

/* part: ranges */
/* The number of the first axis that leaves its range, or is not finite; 0 for none. */
static int axis_beyond_range(const double commands[RIG_AXES])
{
    for (int i = 0; i < RIG_AXES; i++)
        if (!(commands[i] >= RANGE[i][0] && commands[i] <= RANGE[i][1]))
            return i + 1;
    return 0;
}

int rig_start(struct rig_state *state, const double commands[RIG_AXES])
{
    for (int i = 0; i < RIG_AXES; i++) {
        if (!state)
            return RIG_NO_STATE;
        state->command[i] = state->play[i] = commands ? commands[i] : rig_home[i];
        if (!isfinite(state->play[i]))
            return RIG_NO_STATE;
    }
    return RIG_OK;
}

/* Hand out commands that were found, m or rad, and move the state on; beyond a range nothing is changed. */
static int commanded(const double found[RIG_AXES], struct rig_state *state, double commands[RIG_AXES])
{
    if (axis_beyond_range(found))
        return RIG_OUT_OF_STROKE;
    for (int i = 0; i < RIG_AXES; i++) {
        commands[i] = found[i];
        if (state) {
            state->play[i] = fmin(fmax(state->play[i], found[i] - 0.5 * GAP[i]), found[i] + 0.5 * GAP[i]);
            state->command[i] = found[i];
        }
    }
    return RIG_OK;
}

/* part: correct */
/* Lengths (m) to command for T, and where the struts' tips are (m, base frame); ranges are not looked at. */
static int corrected(const struct placed *wanted, const double *channels, struct rig_state *state, double tip[6][3],
                     double found[6])
{
    struct placed T = *wanted;
    double goal[6], effective[6];
    int status = RIG_OK;
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
    return status == RIG_OK ? command(effective, (const double(*)[3])tip, channels, state, found) : status;
}

int rig_correct(const double pose[6], const double *channels, struct rig_state *state, double lengths[6])
{
    struct placed T;
    double tip[6][3], found[6];
    for (int i = 0; i < 6; i++)
        if (!isfinite(pose[i]))
            return RIG_BAD_POSE;
    for (int i = 0; i < 3; i++)
        T.p[i] = pose[i];
    rotation(pose + 3, T.R);
    const int status = corrected(&T, channels, state, tip, found);
    return status == RIG_OK ? commanded(found, state, lengths) : status;
}
