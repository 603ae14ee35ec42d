/* struts/1: numbered and checked frames in, axes that start and arrive together out, a watchdog that stops them. */
#include "struts.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef enum { IDLE, MOVING, HOMING } activity;

static const struts_board *board;
static uint32_t boot;
static activity doing;
static bool homed;
static const char *fault; /* 0 for none */
static int32_t at[STRUTS_MAX], start[STRUTS_MAX], target[STRUTS_MAX];
static uint32_t begun, heard, watch_ms, homing_ms;
static float cruise, ramp;      /* ms */
static bool braking;
static float brake_share, brake_rate, brake_slope; /* of the way, per ms, per ms^2 */
static uint32_t brake_begun;
static bool axis_home[STRUTS_MAX];

static char line[STRUTS_LINE];
static uint8_t used;
static bool too_long;
static long last_number = -1;
static uint16_t last_sum;
static char last_answer[STRUTS_LINE + 64];

static uint16_t checksum(const char *text) /* CRC-16/CCITT-FALSE */
{
    uint16_t crc = 0xFFFF;
    for (; *text; text++) {
        crc ^= (uint16_t)((uint8_t)*text << 8);
        for (uint8_t bit = 0; bit < 8; bit++)
            crc = (crc & 0x8000) ? (uint16_t)((crc << 1) ^ 0x1021) : (uint16_t)(crc << 1);
    }
    return crc;
}

static void send(const char *body)
{
    char out[STRUTS_LINE + 80];
    snprintf(out, sizeof out, "<%s*%04X\n", body, (unsigned)checksum(body));
    board->write(out);
}

static void answer(long number, uint16_t sum, const char *text, bool keep)
{
    char body[STRUTS_LINE + 64];
    snprintf(body, sizeof body, "%ld %s", number, text);
    last_number = keep ? number : -1;
    last_sum = sum;
    strcpy(last_answer, body);
    send(body);
}

/* Share of the way done, and its rate per ms, so long (ms) after a move began. */
static float share_at(float t, float *rate)
{
    float whole = cruise + ramp;
    if (t >= whole) {
        *rate = 0;
        return 1;
    }
    if (t < ramp) {
        *rate = t / (ramp * cruise);
        return t * t / (2 * ramp * cruise);
    }
    if (t > cruise) {
        float left = whole - t;
        *rate = left / (ramp * cruise);
        return 1 - left * left / (2 * ramp * cruise);
    }
    *rate = 1 / cruise;
    return (t - ramp / 2) / cruise;
}

static void go_to_share(float share)
{
    for (uint8_t i = 0; i < board->axes; i++) {
        at[i] = share >= 1 ? target[i] : start[i] + (int32_t)((float)(target[i] - start[i]) * share);
        board->follow(i, at[i]);
    }
}

static void stop(void)
{
    if (doing == MOVING && !braking) {
        float rate;
        brake_begun = board->millis();
        brake_share = share_at((float)(brake_begun - begun), &rate);
        brake_rate = rate;
        brake_slope = 1 / ((ramp > 0 ? ramp : (float)board->brake_ms) * cruise);
        braking = true;
    } else if (doing == HOMING) {
        doing = IDLE; /* slow enough to stand at once */
    }
}

static void move_on(uint32_t now)
{
    if (!braking) {
        float rate, share = share_at((float)(now - begun), &rate);
        go_to_share(share);
        if (share >= 1)
            doing = IDLE;
        return;
    }
    float t = (float)(now - brake_begun), end = brake_rate / brake_slope;
    if (t > end)
        t = end;
    go_to_share(brake_share + brake_rate * t - brake_slope * t * t / 2);
    if (t >= end) {
        doing = IDLE;
        braking = false;
    }
}

static void home_on(uint32_t now)
{
    int32_t way = (int32_t)(now - homing_ms) * board->homing_speed;
    bool all = true;
    homing_ms = now;
    for (uint8_t i = 0; i < board->axes; i++) {
        if (axis_home[i])
            continue;
        if (board->on_switch(i)) {
            axis_home[i] = true;
            continue;
        }
        all = false;
        at[i] -= way;
        board->follow(i, at[i]);
        if (start[i] - at[i] > board->homing_travel) { /* one fails, all stop */
            doing = IDLE;
            fault = "home";
            return;
        }
    }
    if (all) {
        for (uint8_t i = 0; i < board->axes; i++)
            at[i] = board->home[i];
        doing = IDLE;
        homed = true;
    }
}

static void state(char *out, size_t size)
{
    static const char *const names[] = {"idle", "moving", "homing"};
    size_t n = (size_t)snprintf(out, size, "OK %s %d %08lX %s", names[doing], homed, (unsigned long)boot, fault ? fault : "-");
    for (uint8_t i = 0; i < board->axes && n < size; i++)
        n += (size_t)snprintf(out + n, size - n, " %ld", (long)at[i]);
}

/* Whole numbers separated by blanks; how many there are, -1 for anything else. */
static int numbers(const char *text, long *values, int most)
{
    int count = 0;
    while (*text) {
        char *end;
        if (count == most || *text == ' ' || *text == '+')
            return -1;
        values[count++] = strtol(text, &end, 10);
        if (end == text || (*end && *end != ' ') || (*end == ' ' && !end[1]))
            return -1;
        text = *end ? end + 1 : end;
    }
    return count;
}

static const char *begin_move(const char *text)
{
    long values[2 + STRUTS_MAX];
    char *rest;
    unsigned long of = strtoul(text, &rest, 16);
    if (*rest != ' ' || numbers(rest + 1, values, 2 + STRUTS_MAX) != 2 + board->axes || values[0] < 1 || values[1] < 0 || values[1] > values[0])
        return "ERR 2";
    if (of != boot)
        return "ERR 6";
    if (fault)
        return "ERR 7";
    if (!homed)
        return "ERR 3";
    if (doing != IDLE)
        return "ERR 5";
    for (uint8_t i = 0; i < board->axes; i++)
        if (values[2 + i] < board->low[i] || values[2 + i] > board->high[i])
            return "ERR 4";
    for (uint8_t i = 0; i < board->axes; i++) {
        start[i] = at[i];
        target[i] = (int32_t)values[2 + i];
    }
    cruise = (float)values[0];
    ramp = (float)values[1];
    begun = board->millis();
    braking = false;
    doing = MOVING;
    return "OK";
}

static const char *begin_homing(void)
{
    if (doing != IDLE)
        return "ERR 5";
    fault = 0;
    homed = false;
    for (uint8_t i = 0; i < board->axes; i++) {
        start[i] = at[i];
        axis_home[i] = false;
    }
    homing_ms = board->millis();
    doing = HOMING;
    return "OK";
}

static void carry_out(long number, uint16_t sum, const char *text)
{
    char out[STRUTS_LINE + 48];
    const char *what = "ERR 1";
    if (!strcmp(text, "STATE")) {
        state(out, sizeof out);
        what = out;
    } else if (!strcmp(text, "HELLO")) {
        snprintf(out, sizeof out, "OK struts/1 axes=%d boot=%08lX line=%d %s", board->axes, (unsigned long)boot, STRUTS_LINE, board->name);
        what = out;
    } else if (!strcmp(text, "STOP")) {
        stop();
        if (fault && !strcmp(fault, "silent"))
            fault = 0;
        what = "OK";
    } else if (!strcmp(text, "HOME")) {
        what = begin_homing();
    } else if (!strcmp(text, "UNLOCK")) {
        fault = 0;
        what = "OK";
    } else if (!strncmp(text, "WATCH ", 6)) {
        long ms;
        what = numbers(text + 6, &ms, 1) == 1 && ms >= 10 && ms <= 60000 ? "OK" : "ERR 2";
        if (what[0] == 'O')
            watch_ms = (uint32_t)ms;
    } else if (!strncmp(text, "MOVE ", 5)) {
        what = begin_move(text + 5);
    }
    answer(number, sum, what, strcmp(text, "HELLO") != 0);
}

/* A line that has come whole: the last frame in it, if it is sound. */
static void take_line(void)
{
    char *frame = strrchr(line, '>'), *star = frame ? strrchr(frame, '*') : 0, *end;
    if (!used)
        return;
    if (star && strlen(star) == 5) {
        uint16_t said = (uint16_t)strtoul(star + 1, &end, 16);
        *star = 0;
        long number = strtol(frame + 1, &end, 10);
        if (!too_long && !*(star + 5) && said == checksum(frame + 1) && end > frame + 1 && *end == ' ' && number >= 0 && number <= 65535) {
            heard = board->millis();
            if (number == last_number && said == last_sum)
                send(last_answer); /* asked again: answered again, not carried out again */
            else
                carry_out(number, said, end + 1);
            return;
        }
    }
    send("- NAK");
}

static void take_byte(int byte)
{
    if (byte == '!') {
        stop();
    } else if (byte == '\n') {
        line[used] = 0;
        take_line();
        used = 0;
        too_long = false;
    } else if (used < STRUTS_LINE - 1) {
        line[used++] = byte ? (char)byte : '?';
    } else {
        too_long = true;
    }
}

void struts_setup(const struts_board *a_board)
{
    char body[24];
    board = a_board;
    boot = board->boot();
    watch_ms = 1000;
    heard = board->millis();
    snprintf(body, sizeof body, "- BOOT %08lX", (unsigned long)boot);
    send(body);
}

void struts_loop(void)
{
    int byte;
    while ((byte = board->read()) >= 0)
        take_byte(byte);
    uint32_t now = board->millis();
    if (doing != IDLE && !braking && now - heard > watch_ms) {
        fault = "silent";
        stop();
    }
    if (doing != IDLE && board->motor_fault()) {
        fault = "motor";
        stop();
    }
    if (doing == MOVING)
        move_on(now);
    else if (doing == HOMING)
        home_on(now);
}
