"""LinuxCNC's interface of a kinematics module, as its manual documents it: least headers, and a HAL in C."""

HEADERS = {
    "rtapi.h": """#pragma once
#define RTAPI_MSG_ERR 1
#define RTAPI_MSG_WARN 2
#define MODULE_LICENSE(text) extern const char rtapi_license[]; const char rtapi_license[] = text
#define EXPORT_SYMBOL(name) extern const char rtapi_exported_##name[]; const char rtapi_exported_##name[] = #name
void rtapi_print_msg(int level, const char *text, ...) __attribute__((format(printf, 2, 3)));
""",
    "rtapi_app.h": "#pragma once\nint rtapi_app_main(void);\nvoid rtapi_app_exit(void);\n",
    "hal.h": """#pragma once
#include <stdint.h>
typedef volatile double hal_float_t;
typedef volatile int32_t hal_s32_t;
typedef volatile uint32_t hal_u32_t;
typedef enum { HAL_IN = 16, HAL_OUT = 32 } hal_pin_dir_t;
int hal_init(const char *name);
int hal_ready(int component);
int hal_exit(int component);
void *hal_malloc(long size);
int hal_pin_float_newf(hal_pin_dir_t, hal_float_t **, int, const char *, ...) __attribute__((format(printf, 4, 5)));
int hal_pin_s32_newf(hal_pin_dir_t, hal_s32_t **, int, const char *, ...) __attribute__((format(printf, 4, 5)));
int hal_pin_u32_newf(hal_pin_dir_t, hal_u32_t **, int, const char *, ...) __attribute__((format(printf, 4, 5)));
""",
    "kinematics.h": """#pragma once
typedef struct { double x, y, z; } PmCartesian;
typedef struct EmcPose { PmCartesian tran; double a, b, c, u, v, w; } EmcPose;
typedef enum { KINEMATICS_IDENTITY = 1, KINEMATICS_FORWARD_ONLY, KINEMATICS_INVERSE_ONLY, KINEMATICS_BOTH
} KINEMATICS_TYPE;
typedef unsigned long int KINEMATICS_FORWARD_FLAGS;
typedef unsigned long int KINEMATICS_INVERSE_FLAGS;
int kinematicsForward(const double *, EmcPose *, const KINEMATICS_FORWARD_FLAGS *, KINEMATICS_INVERSE_FLAGS *);
int kinematicsInverse(const EmcPose *, double *, const KINEMATICS_INVERSE_FLAGS *, KINEMATICS_FORWARD_FLAGS *);
KINEMATICS_TYPE kinematicsType(void);
int kinematicsSwitchable(void);
int kinematicsSwitch(int type);
#define KINS_NOT_SWITCHABLE \\
    int kinematicsSwitchable(void) { return 0; } \\
    int kinematicsSwitch(int type) { (void)type; return 0; } \\
    EXPORT_SYMBOL(kinematicsSwitchable); \\
    EXPORT_SYMBOL(kinematicsSwitch);
""",
}

# What HAL and RTAPI do of it: pins by name, the latest message, at most so many pins as `most_pins` says.
HAL = r"""
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "rtapi.h"
#include "rtapi_app.h"
#include "hal.h"

static char names[64][48];
static void *values[64];
static int pins;
extern int most_pins, ready, messages;
extern char message[256];
int most_pins = 64, ready = 0, messages = 0;
char message[256];
void *pin(const char *name);

void *pin(const char *name)
{
    for (int i = 0; i < pins; i++)
        if (!strcmp(names[i], name))
            return values[i];
    return 0;
}

static void *new_pin(const char *text, va_list given)
{
    if (pins == most_pins || vsnprintf(names[pins], 48, text, given) > 47)
        return 0;
    return values[pins++] = calloc(1, 8);
}

#define NEW(kind) \
    int hal_pin_##kind##_newf(hal_pin_dir_t way, hal_##kind##_t **at, int component, const char *text, ...) \
    { \
        va_list given; \
        (void)way; \
        va_start(given, text); \
        *at = new_pin(text, given); \
        va_end(given); \
        return *at && component == 7 ? 0 : -22; \
    }
NEW(float)
NEW(s32)
NEW(u32)

void *hal_malloc(long size) { return calloc(1, (size_t)size); }
int hal_init(const char *name) { return strcmp(name, "rigkins") ? -1 : 7; }
int hal_ready(int component) { ready = component; return 0; }
int hal_exit(int component) { ready = 0; return component == 7 ? 0 : -22; }

void rtapi_print_msg(int level, const char *text, ...)
{
    va_list given;
    (void)level;
    va_start(given, text);
    vsnprintf(message, sizeof message, text, given);
    va_end(given);
    messages++;
}
"""
