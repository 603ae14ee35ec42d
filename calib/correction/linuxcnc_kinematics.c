/* LinuxCNC's kinematics by this correction: a module for LinuxCNC 2.8 and 2.9 (uspace), built by halcompile. */
#include <rtapi.h>
#include <rtapi_app.h>
#include <hal.h>
#include <kinematics.h>

MODULE_LICENSE("GPL");

static struct signals {
    hal_float_t *channels[RIG_CHANNELS + 1];
    hal_s32_t *inverse_status, *forward_status, *forward_steps; /* of the latest calls */
    hal_s32_t *refused, *refused_strut;                         /* of the latest inverse that was refused */
    hal_u32_t *refusals;                                        /* inverses refused since the start */
} *signals;
static int component;

static void read_channels(double *channels)
{
    for (int i = 0; i < RIG_CHANNELS; i++)
        channels[i] = *signals->channels[i];
}

static void world_at(const EmcPose *given, double world[6])
{
    world[0] = given->tran.x;
    world[1] = given->tran.y;
    world[2] = given->tran.z;
    world[3] = given->a;
    world[4] = given->b;
    world[5] = given->c;
}

/* While joints have no pose, LinuxCNC takes the world's home for theirs, and in world mode would have them leap to it; or
   to 0, where the first pose of that mode is refused. So they are held at the first one. Another is then refused. */
#define ALONE 4 /* calls of forward kinematics without one of inverse kinematics: this is not world mode */
static double held_pose[6], held_joints[6];
static int holding, alone, known; /* known: joints have had a pose, so it is not LinuxCNC that starts */

/* Whether the joints are held for a pose. */
static int is_held(const double at[6])
{
    for (int i = 0; i < 6; i++) {
        if (holding && !(fabs(at[i] - held_pose[i]) < 1e-9)) {
            holding = 0;
            return 0;
        }
    }
    for (int i = 0; i < 6; i++)
        held_pose[i] = at[i];
    holding = 1;
    return 1;
}

/* Joints (machine units) of a pose; below 0, and joints as they were, where the pose is refused. */
int kinematicsInverse(const EmcPose *world, double *joint, const KINEMATICS_INVERSE_FLAGS *iflags,
                      KINEMATICS_FORWARD_FLAGS *fflags)
{
    double at[6], channels[RIG_CHANNELS + 1], lengths[6];
    int strut = 0;
    const int lost = *signals->forward_status;
    (void)iflags;
    (void)fflags;
    world_at(world, at);
    read_channels(channels);
    alone = 0;
    if (lost != RIG_OK && is_held(at)) {
        for (int i = 0; i < 6; i++)
            joint[i] = held_joints[i];
        return 0;
    }
    const int status = lost != RIG_OK ? lost : lengths_of(at, channels, lengths, &strut);
    if (status == RIG_OK) {
        for (int i = 0; i < 6; i++)
            joint[i] = lengths[i] * UNITS;
    } else {
        if (lost != RIG_OK)
            rtapi_print_msg(RTAPI_MSG_ERR, "rigkins: pose refused: the joints have none; jog them back in joint mode\n");
        else if (status != *signals->inverse_status)
            rtapi_print_msg(RTAPI_MSG_ERR, "rigkins: pose refused: %s (strut %d; 0 for none)\n", REFUSALS[status],
                            strut);
        *signals->refused = status;
        *signals->refused_strut = strut;
        *signals->refusals += 1;
    }
    *signals->inverse_status = status;
    return -status;
}

/* Pose of joints, from the pose given or else from home; below 0, and the pose as it was, where there is none. */
int kinematicsForward(const double *joint, EmcPose *world, const KINEMATICS_FORWARD_FLAGS *fflags,
                      KINEMATICS_INVERSE_FLAGS *iflags)
{
    double at[6], channels[RIG_CHANNELS + 1], lengths[6];
    int steps;
    (void)fflags;
    (void)iflags;
    world_at(world, at);
    read_channels(channels);
    for (int i = 0; i < 6; i++)
        lengths[i] = joint[i] / UNITS;
    const int status = pose_of(lengths, channels, at, &steps);
    if (status == RIG_OK) {
        world->tran.x = at[0];
        world->tran.y = at[1];
        world->tran.z = at[2];
        world->a = at[3];
        world->b = at[4];
        world->c = at[5];
        holding = 0;
        known = 1;
    } else {
        if (status != *signals->forward_status)
            rtapi_print_msg(known ? RTAPI_MSG_ERR : RTAPI_MSG_WARN, "rigkins: no pose of the joints: %s\n",
                            REFUSALS[status]);
        if (alone < ALONE)
            alone++;
        else
            holding = 0;
        for (int i = 0; i < 6 && !holding; i++)
            held_joints[i] = joint[i];
    }
    *signals->forward_status = status;
    *signals->forward_steps = steps;
    return -status;
}

KINEMATICS_TYPE kinematicsType(void)
{
    return KINEMATICS_BOTH;
}

EXPORT_SYMBOL(kinematicsType);
EXPORT_SYMBOL(kinematicsForward);
EXPORT_SYMBOL(kinematicsInverse);
#ifdef KINS_NOT_SWITCHABLE
KINS_NOT_SWITCHABLE
#endif

static int new_pins(void)
{
    int failed = 0;
    signals = hal_malloc(sizeof *signals);
    if (!signals)
        return -1;
    failed |= hal_pin_s32_newf(HAL_OUT, &signals->inverse_status, component, "rigkins.inverse-status");
    failed |= hal_pin_s32_newf(HAL_OUT, &signals->forward_status, component, "rigkins.forward-status");
    failed |= hal_pin_s32_newf(HAL_OUT, &signals->forward_steps, component, "rigkins.forward-steps");
    failed |= hal_pin_s32_newf(HAL_OUT, &signals->refused, component, "rigkins.refused");
    failed |= hal_pin_s32_newf(HAL_OUT, &signals->refused_strut, component, "rigkins.refused-strut");
    failed |= hal_pin_u32_newf(HAL_OUT, &signals->refusals, component, "rigkins.refusals");
    for (int i = 0; i < RIG_CHANNELS; i++) {
        failed |= hal_pin_float_newf(HAL_IN, &signals->channels[i], component, "rigkins.%s", CHANNEL_NAMES[i]);
        if (!failed)
            *signals->channels[i] = CHANNEL_MEDIANS[i];
    }
    return failed ? -1 : 0;
}

int rtapi_app_main(void)
{
    component = hal_init("rigkins");
    if (component < 0)
        return component;
    if (new_pins() != 0) {
        hal_exit(component);
        return -1;
    }
    hal_ready(component);
    return 0;
}

void rtapi_app_exit(void)
{
    hal_exit(component);
}
