"""grblHAL's interface of a kinematics plug-in, as its core of build 20260817 has it: least headers, and a core in C."""

HEADERS = {
    "grbl/hal.h": """#pragma once
#include <stdbool.h>
#include <stdint.h>
#define N_AXIS 6
#define KINEMATICS_API
typedef union { uint8_t mask, bits, value; } axes_signals_t;
typedef union { float values[N_AXIS]; struct { float x, y, z, a, b, c; }; } coord_data_t;
typedef union { int32_t values[N_AXIS]; } mpos_t;
typedef struct { float x, y; } point_2d_t;
typedef struct { uint8_t axis_0, axis_1, axis_linear; } plane_t;
typedef struct { coord_data_t min, max; } work_envelope_t;
typedef struct { uint32_t value; } report_tracking_flags_t;
typedef uint_fast16_t sys_state_t;
typedef enum { Status_OK = 0, Status_BadNumberFormat = 2, Status_InvalidStatement = 3 } status_code_t;
typedef enum { Message_Plain = 0, Message_Info, Message_Warning } message_type_t;
typedef void (*stream_write_ptr)(const char *);
typedef bool (*home_machine_ptr)(axes_signals_t, axes_signals_t);
typedef void (*on_report_options_ptr)(bool);
typedef void (*on_realtime_report_ptr)(stream_write_ptr, report_tracking_flags_t);
typedef void (*on_jog_cancel_ptr)(sys_state_t);
typedef void (*on_execute_realtime_ptr)(sys_state_t);
typedef struct {
    home_machine_ptr home_machine;
    bool (*check_travel_limits)(float *, axes_signals_t, bool, work_envelope_t *);
    bool (*check_arc_travel_limits)(coord_data_t *, coord_data_t *, point_2d_t, float, plane_t, int32_t,
                                    work_envelope_t *);
    void (*apply_travel_limits)(float *, float *, work_envelope_t *);
    on_report_options_ptr on_report_options;
    on_realtime_report_ptr on_realtime_report;
    on_jog_cancel_ptr on_jog_cancel;
    on_execute_realtime_ptr on_execute_realtime;
} grbl_t;
typedef struct { struct { stream_write_ptr write; } stream; } grbl_hal_t;
typedef struct {
    struct { float steps_per_mm; } axis[N_AXIS];
    struct { struct { uint8_t enabled; } flags; } parking;
} settings_t;
extern grbl_t grbl;
extern grbl_hal_t hal;
extern settings_t settings;
char *ftoa(float value, uint8_t decimals);
char *uitoa(uint32_t value);
bool read_float(const char *text, uint_fast8_t *at, float *value);
""",
    "grbl/planner.h": """#pragma once
typedef union {
    uint32_t value;
    struct { uint16_t rapid_motion : 1, inverse_time : 1, jog_motion : 1, target_valid : 1, target_validated : 1; };
} planner_cond_t;
typedef struct { float feed_rate, rate_multiplier; planner_cond_t condition; } plan_line_data_t;
""",
    "grbl/kinematics/interface.h": """#pragma once
#include "../planner.h"
typedef int homing_mode_t;
typedef struct {
    coord_data_t *(*transform_steps_to_cartesian)(coord_data_t *, mpos_t *);
    coord_data_t *(*transform_from_cartesian)(coord_data_t *, coord_data_t *);
    coord_data_t *(*segment_line)(coord_data_t *, coord_data_t *, plan_line_data_t *, bool);
    uint_fast8_t (*limits_get_axis_mask)(uint_fast8_t);
    void (*limits_set_target_pos)(uint_fast8_t);
    void (*limits_set_machine_positions)(axes_signals_t);
    bool (*homing_cycle_validate)(axes_signals_t);
    float (*homing_cycle_get_feedrate)(axes_signals_t, float, homing_mode_t);
} kinematics_t;
extern kinematics_t kinematics;
""",
    "grbl/machine_limits.h": "#pragma once\nvoid limits_set_machine_positions(axes_signals_t, bool);\n",
    "grbl/report.h": "#pragma once\nvoid report_message(const char *text, message_type_t type);\n",
    "grbl/state_machine.h": "#pragma once\n#define STATE_CHECK_MODE 2\nsys_state_t state_get(void);\n",
    "grbl/system.h": """#pragma once
typedef struct { int32_t position[N_AXIS]; } system_t;
typedef struct {
    const char *command;
    status_code_t (*execute)(sys_state_t, char *);
    union { uint8_t flags; } flags;
    union { const char *str; const char *(*fn)(const char *); } help;
} sys_command_t;
typedef struct sys_commands_str {
    const uint8_t n_commands;
    const sys_command_t *commands;
    struct sys_commands_str *next;
    struct sys_commands_str *(*on_get_commands)(void);
} sys_commands_t;
extern system_t sys;
void system_register_commands(sys_commands_t *commands);
""",
}

# What a core does of it: lines become targets of motors, in whole steps; homing runs each motor to its own switch.
CORE = r"""
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "grbl/hal.h"
#include "grbl/kinematics/interface.h"
#include "grbl/machine_limits.h"
#include "grbl/report.h"
#include "grbl/state_machine.h"
#include "grbl/system.h"

enum { RAPID = 1, INVERSE_TIME = 2, JOG = 4, CANCELLED = 8, BROKEN_OFF = 16 };
enum { PULLOFF_MM = 1 };

grbl_t grbl;
grbl_hal_t hal;
settings_t settings;
system_t sys;
kinematics_t kinematics;
extern char written[4096];
extern int state;
extern float switches[N_AXIS];
char written[4096];
int state;
float switches[N_AXIS];
static sys_commands_t *commands;

void my_plugin_init(void);
void start(float steps_per_mm);
void park(int enabled);
int line(const float *goal, float feed, int kind, float *motors, float *feeds, float *multipliers, int most);
int jog_allowed(const float *goal);
void where(float *pose);
int home(float *pose_in_between);
int command(char *args);
void report(void);

static void note(const char *text)
{
    strncat(written, text, sizeof written - strlen(written) - 1);
}
char *ftoa(float value, uint8_t decimals)
{
    static char text[32];
    snprintf(text, sizeof text, "%.*f", decimals, (double)value);
    return text;
}
char *uitoa(uint32_t value)
{
    static char text[16];
    snprintf(text, sizeof text, "%u", value);
    return text;
}
bool read_float(const char *text, uint_fast8_t *at, float *value)
{
    char *end;
    *value = strtof(text + *at, &end);
    const bool some = end != text + *at;
    *at = (uint_fast8_t)(end - text);
    return some;
}
void report_message(const char *text, message_type_t type)
{
    note(type == Message_Warning ? "[MSG:Warning: " : "[MSG:");
    note(text);
    note("]\r\n");
}
sys_state_t state_get(void) { return (sys_state_t)state; }
void system_register_commands(sys_commands_t *given) { commands = given; }
int command(char *args) { return commands->commands[0].execute((sys_state_t)state, args); }
void report(void) { grbl.on_report_options(false); grbl.on_realtime_report(note, (report_tracking_flags_t){0}); }

void limits_set_machine_positions(axes_signals_t cycle, bool add_pulloff)
{
    for (int i = 0; i < N_AXIS; i++)
        if (cycle.mask >> i & 1)
            sys.position[i] = (int32_t)lroundf((switches[i] + (add_pulloff ? PULLOFF_MM : 0)) *
                                               settings.axis[i].steps_per_mm);
}

/* Each motor runs down to its switch, and off it: targets are those of the plug-in. */
static bool home_by_core(axes_signals_t cycle, axes_signals_t auto_square)
{
    coord_data_t target, motors;
    (void)auto_square;
    for (int i = 0; i < N_AXIS; i++)
        if (cycle.mask >> i & 1)
            kinematics.limits_set_target_pos((uint_fast8_t)i);
    kinematics.transform_steps_to_cartesian(&target, (mpos_t *)sys.position);
    for (int i = 0; i < N_AXIS; i++)
        target.values[i] -= 1000.0f;
    kinematics.transform_from_cartesian(&motors, &target);
    for (int i = 0; i < N_AXIS; i++)
        if (motors.values[i] != -1000.0f || kinematics.limits_get_axis_mask((uint_fast8_t)i) != 1u << i)
            return false;
    for (int up = 0; up < 2; up++) {
        for (int i = 0; i < N_AXIS; i++)
            sys.position[i] += (int32_t)lroundf((up ? PULLOFF_MM : -PULLOFF_MM) * settings.axis[i].steps_per_mm);
        grbl.on_execute_realtime(0);
    }
    kinematics.limits_set_machine_positions(cycle);
    return true;
}

void start(float steps_per_mm)
{
    for (int i = 0; i < N_AXIS; i++)
        settings.axis[i].steps_per_mm = steps_per_mm;
    hal.stream.write = note;
    grbl.home_machine = home_by_core;
    my_plugin_init();
}

void park(int enabled) { settings.parking.flags.enabled = (uint8_t)enabled; }

int home(float *pose_in_between)
{
    const axes_signals_t all = {63};
    const bool done = grbl.home_machine(all, (axes_signals_t){0});
    where(pose_in_between);
    return done;
}

void where(float *pose)
{
    coord_data_t position;
    memcpy(pose, kinematics.transform_steps_to_cartesian(&position, (mpos_t *)sys.position)->values, sizeof position);
}

int jog_allowed(const float *goal)
{
    float target[N_AXIS], before[N_AXIS];
    work_envelope_t envelope = {{{0}}, {{0}}};
    memcpy(target, goal, sizeof target);
    memcpy(before, goal, sizeof before);
    grbl.apply_travel_limits(target, NULL, &envelope);
    if (memcmp(target, before, sizeof target))
        return -1;
    return grbl.check_travel_limits(target, (axes_signals_t){63}, true, &envelope);
}

/* Ends of a line's segments (mm of motors), feeds and multipliers; their number, or -1 where it is refused. */
int line(const float *goal, float feed, int kind, float *motors, float *feeds, float *multipliers, int most)
{
    coord_data_t target, position;
    plan_line_data_t plan = {feed, 1.0f, {0}};
    int count = 0;
    plan.condition.rapid_motion = !!(kind & RAPID);
    plan.condition.inverse_time = !!(kind & INVERSE_TIME);
    if (kind & JOG)
        plan.condition.jog_motion = plan.condition.target_valid = plan.condition.target_validated = 1;
    memcpy(target.values, goal, sizeof target);
    for (int i = 0; i < N_AXIS; i++)
        position.values[i] = (float)sys.position[i] / settings.axis[i].steps_per_mm;
    coord_data_t *end = kinematics.segment_line(&target, &position, &plan, true);
    if (!(plan.condition.target_validated && plan.condition.target_valid))
        return -1;
    while (state != STATE_CHECK_MODE && kinematics.segment_line(end, NULL, &plan, false)) {
        if (count == most)
            return -2;
        memcpy(motors + N_AXIS * count, end->values, sizeof *end);
        feeds[count] = plan.feed_rate;
        multipliers[count++] = plan.rate_multiplier;
        for (int i = 0; i < N_AXIS; i++) /* broken off, all is planned and the motors stop after the third */
            if (!(kind & BROKEN_OFF) || count <= 3)
                sys.position[i] = (int32_t)lroundf(end->values[i] * settings.axis[i].steps_per_mm);
        grbl.on_execute_realtime(0);
        plan.feed_rate = feed;
        if (kind & CANCELLED && count == 2)
            grbl.on_jog_cancel(0);
    }
    return count;
}
"""
