/* grblHAL's kinematics by this correction: X Y Z A B C are the platform's pose, the six motors are the struts. */
#include <stdio.h>
#include <string.h>

#include "grbl/hal.h"
#include "grbl/kinematics/interface.h"
#include "grbl/machine_limits.h"
#include "grbl/planner.h"
#include "grbl/report.h"
#include "grbl/state_machine.h"
#include "grbl/system.h"

#ifndef KINEMATICS_API
#error "all of grblHAL has to be compiled with KINEMATICS_API defined"
#endif
#if N_AXIS != 6
#error "all of grblHAL has to be compiled with N_AXIS=6"
#endif
#ifndef RIG_SEGMENT_MM
#define RIG_SEGMENT_MM 0.5 /* mm, longest part of a line in which motors run at constant ratios */
#endif
#ifndef RIG_SEGMENT_DEG
#define RIG_SEGMENT_DEG 0.1 /* degrees, likewise of each of A, B and C */
#endif

enum { RIG_PARKS = 7 }; /* parking sends a pose to the motors, past any kinematics */

extern double rig_channel_values[RIG_CHANNELS + 1]; /* sensors, for firmware that reads them; or by $RIG= */
double rig_channel_values[RIG_CHANNELS + 1];
void my_plugin_init(void);

static double latest[6]; /* mm and degrees, the pose of the latest forward kinematics */
static int pose_status, refused, refused_strut;
static unsigned refusals;
static bool by_motor; /* while homing: axes are the motors themselves */
static home_machine_ptr home_by_core;
static on_report_options_ptr options_of_others;
static on_realtime_report_ptr report_of_others;
static on_jog_cancel_ptr jog_cancel_of_others;
static on_execute_realtime_ptr realtime_of_others;

/* Struts stand off their motors by up to half their play, to the side from which the motors came. */
static double off_motors[6]; /* m, as the motors have run so far */
static float followed[6];    /* mm, as far as they were followed */

static struct line {
    double start[6], goal[6], channels[RIG_CHANNELS + 1];
    double count, next;      /* segments, and of them those handed out */
    double distance;         /* of a segment: mm of the origin or degrees of A, B or C, whichever are more */
    coord_data_t motors;     /* mm, where the latest segment ends */
    double struts[6];        /* m, where the struts are then */
    bool recounted;          /* motors were homed since */
    bool in_check_mode;      /* this line is only checked: the motors stay behind */
    volatile bool cancelled; /* a jog that was broken off */
} line;

static void lengths_at(const float motors[6], double lengths[6])
{
    for (int i = 0; i < 6; i++)
        lengths[i] = MOTOR_ZERO[i] + motors[i] / UNITS;
}

/* Run motors (mm) until struts (m) have these lengths: a strut that turns back stands until its play is taken up. */
static void run_to(const double lengths[6], double struts[6], float motors[6])
{
    for (int i = 0; i < 6; i++) {
        const double off = lengths[i] - struts[i];
        if (PLAY[i] > 0.0 && fabs(off) < 1e-10) /* as `rig correct`: the strut stands where it is to stand */
            continue;
        motors[i] = (float)((lengths[i] + (off > 0.0 ? 0.5 : -0.5) * PLAY[i] - MOTOR_ZERO[i]) * UNITS);
        struts[i] = lengths[i];
    }
}

static void motors_of_steps(const int32_t *steps, float motors[6])
{
    for (int i = 0; i < 6; i++)
        motors[i] = (float)steps[i] / settings.axis[i].steps_per_mm;
}

/* Let struts follow their motors to where these are now; of each turn as far as it was seen. */
static void follow_motors(void)
{
    float motors[6];
    motors_of_steps(sys.position, motors);
    for (int i = 0; i < 6; i++) {
        const double off = off_motors[i] - (double)(motors[i] - followed[i]) / UNITS;
        off_motors[i] = fmin(fmax(off, -0.5 * PLAY[i]), 0.5 * PLAY[i]);
        followed[i] = motors[i];
    }
}

/* Motors are counted anew where they stand: their struts have not moved. */
static void recount_motors(void)
{
    motors_of_steps(sys.position, followed);
    line.recounted = true;
}

static void struts_at(const float motors[6], double struts[6])
{
    lengths_at(motors, struts);
    for (int i = 0; i < 6; i++)
        struts[i] += off_motors[i];
}

/* Count a refusal and state it. Nothing is moved, nothing is clipped. */
static void refuse(int status, int strut)
{
    const char *reason = status == RIG_PARKS ? "parking knows no kinematics, set $41=0" : REFUSALS[status];
    char text[128];
    refused = status;
    refused_strut = strut;
    refusals++;
    if (strut)
        snprintf(text, sizeof text, "pose refused: %s (strut %d)", reason, strut);
    else
        snprintf(text, sizeof text, "pose refused: %s", reason);
    report_message(text, Message_Warning);
}

/* Pose (mm and degrees) of struts (m), NaN where there is none. */
static void pose_of_struts(const double struts[6], double pose[6])
{
    int newton_steps;
    pose_status = pose_of(struts, rig_channel_values, latest, &newton_steps);
    for (int i = 0; i < 6; i++)
        pose[i] = pose_status == RIG_OK ? latest[i] : NAN;
}

static coord_data_t *steps_to_pose(coord_data_t *position, mpos_t *steps)
{
    float motors[6];
    double struts[6], pose[6];
    follow_motors();
    motors_of_steps(steps->values, motors);
    struts_at(motors, struts);
    if (!by_motor)
        pose_of_struts(struts, pose);
    for (int i = 0; i < 6; i++)
        position->values[i] = by_motor ? motors[i] : (float)pose[i];
    return position;
}

/* Motor positions of a pose for motions of the system itself; where they stand for one that is refused. */
static coord_data_t *pose_to_motors(coord_data_t *target, coord_data_t *position)
{
    double pose[6], lengths[6], struts[6];
    float motors[6];
    int strut;
    for (int i = 0; i < 6; i++)
        pose[i] = position->values[i];
    if (by_motor) {
        memcpy(target, position, sizeof *target);
        return target;
    }
    const int status = lengths_of(pose, rig_channel_values, lengths, &strut);
    motors_of_steps(sys.position, motors);
    struts_at(motors, struts);
    if (status == RIG_OK)
        run_to(lengths, struts, motors);
    else
        refuse(status, strut);
    memcpy(target->values, motors, sizeof motors);
    return target;
}

/* The lengths at the end of segment number n of the line; a status where it is refused. */
static int segment_end(double n, double lengths[6], int *strut)
{
    double pose[6];
    for (int i = 0; i < 6; i++)
        pose[i] = n < line.count ? line.start[i] + (line.goal[i] - line.start[i]) * (n / line.count) : line.goal[i];
    return lengths_of(pose, line.channels, lengths, strut);
}

/* Begin where the motors (mm) of the planner stand: where the latest line ends, or where motion was broken off. */
static void begin_at(const float motors[6])
{
    bool goes_on = !line.recounted;
    for (int i = 0; i < 6; i++)
        if (fabsf(motors[i] - line.motors.values[i]) * settings.axis[i].steps_per_mm > 1.0f)
            goes_on = false;
    follow_motors();
    if (!goes_on)
        struts_at(motors, line.struts);
    line.recounted = false;
    memcpy(line.motors.values, motors, sizeof line.motors.values);
}

/* Begin a line: it is refused as a whole, before anything moves, where any of its segments is. */
static int begin_line(const float goal[6], const float motors[6], int *strut)
{
    const bool checks = state_get() == STATE_CHECK_MODE;
    double shift = 0.0, turn = 0.0, ends[6];
    *strut = 0;
    begin_at(motors);
    if (settings.parking.flags.enabled)
        return RIG_PARKS;
    memcpy(line.channels, rig_channel_values, sizeof line.channels);
    if (checks && line.in_check_mode)
        memcpy(line.start, line.goal, sizeof line.start);
    else
        pose_of_struts(line.struts, line.start);
    line.in_check_mode = checks;
    line.cancelled = false;
    line.next = 0.0;
    line.count = 1.0;
    for (int i = 0; i < 6; i++) {
        line.goal[i] = goal[i];
        if (i < 3)
            shift += (line.goal[i] - line.start[i]) * (line.goal[i] - line.start[i]);
        else
            turn = fmax(turn, fabs(line.goal[i] - line.start[i]));
    }
    int status = segment_end(1.0, ends, strut); /* of one segment: the goal */
    if (status == RIG_OK && !isfinite(shift + turn))
        status = pose_status; /* where the motors stand has no pose */
    if (status != RIG_OK)
        return status;
    shift = sqrt(shift);
    line.count = fmax(1.0, fmax(ceil(shift / RIG_SEGMENT_MM), ceil(turn / RIG_SEGMENT_DEG)));
    line.distance = fmax(shift, turn) / line.count;
    for (double n = 1.0; status == RIG_OK && n < line.count; n += 1.0)
        status = segment_end(n, ends, strut);
    return status;
}

/* The next segment; its feed is that of the motors which makes the feed of the pose. */
static coord_data_t *next_segment(plan_line_data_t *plan)
{
    float before[6];
    double lengths[6], moved = 0.0;
    int strut;
    if (line.cancelled || line.next >= line.count)
        return NULL;
    memcpy(before, line.motors.values, sizeof before);
    line.next += 1.0;
    if (segment_end(line.next, lengths, &strut) != RIG_OK)
        return NULL; /* not for channels and pose that were found regular at its beginning */
    run_to(lengths, line.struts, line.motors.values);
    for (int i = 0; i < 6; i++)
        moved += (line.motors.values[i] - before[i]) * (line.motors.values[i] - before[i]);
    moved = sqrt(moved);
    if (plan->condition.inverse_time)
        plan->feed_rate *= (float)line.count;
    else if (!plan->condition.rapid_motion && line.distance > 0.0 && moved > 0.0) {
        plan->feed_rate *= (float)(moved / line.distance);
        plan->rate_multiplier = (float)(line.distance / moved);
    }
    return &line.motors;
}

/* Segments of a line to a pose. position : mm, where the planner's motors stand, at its beginning */
static coord_data_t *segment_line(coord_data_t *target, coord_data_t *position, plan_line_data_t *plan, bool init)
{
    int strut;
    if (!init)
        return next_segment(plan);
    const int status = begin_line(target->values, position->values, &strut);
    plan->condition.target_validated = true;
    plan->condition.target_valid = status == RIG_OK;
    if (status != RIG_OK) {
        line.count = 0.0;
        line.in_check_mode = false;
        refuse(status, strut);
    }
    return &line.motors;
}

/* Whether a pose, or motor positions, may be commanded: always looked at, soft limits enabled or not. */
static bool within_limits(float *target, axes_signals_t axes, bool is_cartesian, work_envelope_t *envelope)
{
    double pose[6], lengths[6];
    int strut = 0, status = RIG_OK;
    (void)axes;
    (void)envelope;
    if (by_motor)
        return true;
    for (int i = 0; i < 6; i++)
        pose[i] = target[i];
    if (is_cartesian)
        status = lengths_of(pose, rig_channel_values, lengths, &strut);
    else {
        lengths_at(target, lengths);
        for (int i = 0; i < 6; i++) /* ranges are of struts: their motors run half a play beyond */
            lengths[i] += lengths[i] < 0.5 * (RANGE[i][0] + RANGE[i][1]) ? 0.5 * PLAY[i] : -0.5 * PLAY[i];
        strut = axis_beyond_range(lengths);
        status = strut ? RIG_OUT_OF_STROKE : RIG_OK;
    }
    if (status != RIG_OK)
        refuse(status, strut);
    return status == RIG_OK;
}

/* In place of clipping a jog: what is beyond a limit is refused by its line. */
static void leave_target(float *target, float *position, work_envelope_t *envelope)
{
    (void)target;
    (void)position;
    (void)envelope;
}

/* Every strut finds its own switch, as an axis of a machine without kinematics does. */
static bool home_struts(axes_signals_t cycle, axes_signals_t auto_square)
{
    by_motor = true;
    const bool done = home_by_core(cycle, auto_square);
    by_motor = false;
    return done;
}

static uint_fast8_t motor_of_axis(uint_fast8_t idx)
{
    return (uint_fast8_t)(1u << idx);
}

static void start_search(uint_fast8_t idx)
{
    follow_motors();
    sys.position[idx] = 0;
    recount_motors();
}

static void found_switches(axes_signals_t cycle)
{
    follow_motors();
    limits_set_machine_positions(cycle, by_motor);
    recount_motors();
}

static void look_at_motors(sys_state_t state)
{
    follow_motors();
    if (realtime_of_others)
        realtime_of_others(state);
}

static void cancel_jog(sys_state_t state)
{
    line.cancelled = true;
    if (jog_cancel_of_others)
        jog_cancel_of_others(state);
}

static void report_motors(stream_write_ptr write, report_tracking_flags_t report)
{
    float motors[6];
    motors_of_steps(sys.position, motors);
    for (int i = 0; i < 6; i++) {
        write(i ? "," : "|KPos:");
        write(ftoa(motors[i], 4));
    }
    if (pose_status != RIG_OK) {
        write("|RIG:");
        write(uitoa((uint32_t)pose_status));
    }
    if (report_of_others)
        report_of_others(write, report);
}

static void report_plugin_options(bool newopt)
{
    if (options_of_others)
        options_of_others(newopt);
    if (!newopt)
        hal.stream.write("[KINEMATICS:rigkins of " RIGKINS_MADE "]\r\n");
}

/* $RIG lists refusals and sensors; $RIG=NAME:VALUE sets a sensor, for lines that begin later. */
static status_code_t rig_command(sys_state_t state, char *args)
{
    char text[96], *value = args ? strchr(args, ':') : NULL;
    (void)state;
    if (args) {
        uint_fast8_t read = 0;
        float number;
        if (!value)
            return Status_InvalidStatement;
        *value++ = '\0';
        if (!read_float(value, &read, &number) || value[read] || !isfinite(number))
            return Status_BadNumberFormat;
        for (int i = 0; i < RIG_CHANNELS; i++)
            if (!strcmp(args, CHANNEL_NAMES[i])) {
                rig_channel_values[i] = number;
                return Status_OK;
            }
        return Status_InvalidStatement;
    }
    snprintf(text, sizeof text, "[RIG:refusals=%u,refused=%d,strut=%d]\r\n", refusals, refused, refused_strut);
    hal.stream.write(text);
    for (int i = 0; i < RIG_CHANNELS; i++) {
        hal.stream.write("[RIG:");
        hal.stream.write(CHANNEL_NAMES[i]);
        hal.stream.write("=");
        hal.stream.write(ftoa((float)rig_channel_values[i], 3));
        hal.stream.write("]\r\n");
    }
    return Status_OK;
}

void my_plugin_init(void)
{
    static const sys_command_t list[] = {
        {"RIG", rig_command, {0}, {"list poses refused and sensors, or set a sensor: $RIG=NAME:VALUE"}}};
    static sys_commands_t commands = {sizeof list / sizeof *list, list, NULL, NULL};
    memcpy(rig_channel_values, CHANNEL_MEDIANS, sizeof CHANNEL_MEDIANS);
    world_of(&HOME_POSE, latest);
    memcpy(line.struts, MOTOR_ZERO, sizeof MOTOR_ZERO);

    kinematics.transform_steps_to_cartesian = steps_to_pose;
    kinematics.transform_from_cartesian = pose_to_motors;
    kinematics.segment_line = segment_line;
    kinematics.limits_get_axis_mask = motor_of_axis;
    kinematics.limits_set_target_pos = start_search;
    kinematics.limits_set_machine_positions = found_switches;

    home_by_core = grbl.home_machine;
    grbl.home_machine = home_struts;
    grbl.check_travel_limits = within_limits;
    grbl.check_arc_travel_limits = NULL; /* every chord of an arc is a line, and refused as one */
    grbl.apply_travel_limits = leave_target;

    options_of_others = grbl.on_report_options;
    grbl.on_report_options = report_plugin_options;
    report_of_others = grbl.on_realtime_report;
    grbl.on_realtime_report = report_motors;
    realtime_of_others = grbl.on_execute_realtime;
    grbl.on_execute_realtime = look_at_motors;
    jog_cancel_of_others = grbl.on_jog_cancel;
    grbl.on_jog_cancel = cancel_jog;
    system_register_commands(&commands);
}
