/* The line protocol struts/1 (docs/protocol.md) for a controller of up to STRUTS_MAX axes. No heap, no wait; call struts_loop often. */
#ifndef STRUTS_H
#define STRUTS_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define STRUTS_MAX 6
#define STRUTS_LINE 128 /* bytes of the longest frame, its end included */

/* What a board brings. Positions are in nm, as the controller counts. */
typedef struct {
    uint8_t axes;                            /* 1 .. STRUTS_MAX */
    const char *name;                        /* one word, said in HELLO */
    int32_t low[STRUTS_MAX], high[STRUTS_MAX]; /* nm, soft limits */
    int32_t home[STRUTS_MAX];                /* nm, the count on the homing switch */
    int32_t homing_speed;                    /* nm per ms, towards lower counts */
    int32_t homing_travel;                   /* nm after which a switch is missing */
    uint16_t brake_ms;                       /* from full speed to standing, where a move states no ramp */
    uint32_t (*boot)(void);                  /* a number that is another after every start */
    uint32_t (*millis)(void);
    int (*read)(void);                       /* a byte, -1 for none */
    void (*write)(const char *text);         /* never waits for long */
    void (*follow)(uint8_t axis, int32_t nm); /* where an axis shall be now */
    bool (*on_switch)(uint8_t axis);
    bool (*motor_fault)(void);
} struts_board;

void struts_setup(const struts_board *board);
void struts_loop(void);

#ifdef __cplusplus
}
#endif
#endif
