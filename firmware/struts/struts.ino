// A six-strut controller on an Arduino-like board: step and direction pins, a homing switch per strut at its short end.
// Put in your pins, screw and switches; the protocol is in struts.c and needs no change.
#include <EEPROM.h>
#include "struts.h"

static const uint8_t AXES = 6;
static const uint8_t STEP[AXES] = {22, 24, 26, 28, 30, 32}, DIRECTION[AXES] = {23, 25, 27, 29, 31, 33}, SWITCH[AXES] = {34, 35, 36, 37, 38, 39};
static const uint8_t FAULT = 40;            // drivers' fault lines together, low when in fault
static const int32_t NM_PER_STEP = 1250;    // 4 mm lead, 200 x 16 steps
static int32_t wanted[AXES], stepped[AXES]; // steps

static uint32_t next_boot() { uint32_t n; EEPROM.get(0, n); n++; EEPROM.put(0, n); return n; }
static uint32_t now_ms() { return millis(); }
static int next_byte() { return Serial.available() ? Serial.read() : -1; }
static void say(const char *text) { Serial.print(text); }
static void follow(uint8_t axis, int32_t nm) { wanted[axis] = nm / NM_PER_STEP; }
static bool on_switch(uint8_t axis) { return digitalRead(SWITCH[axis]) == LOW; }
static bool motor_fault() { return digitalRead(FAULT) == LOW; }

static struts_board board = {
    AXES, "arduino",
    {0, 0, 0, 0, 0, 0}, {100000000, 100000000, 100000000, 100000000, 100000000, 100000000}, // soft limits: 100 mm of travel
    {0, 0, 0, 0, 0, 0}, 2000, 120000000, 200,                                               // 0 on the switch; 2 mm/s; 120 mm; 0.2 s
    next_boot, now_ms, next_byte, say, follow, on_switch, motor_fault};

void setup()
{
    Serial.begin(115200);
    for (uint8_t i = 0; i < AXES; i++) {
        pinMode(STEP[i], OUTPUT);
        pinMode(DIRECTION[i], OUTPUT);
        pinMode(SWITCH[i], INPUT_PULLUP);
    }
    pinMode(FAULT, INPUT_PULLUP);
    struts_setup(&board);
}

void loop()
{
    struts_loop();
    for (uint8_t i = 0; i < AXES; i++) { // one step each a turn; a turn takes far less than a millisecond
        if (wanted[i] == stepped[i])
            continue;
        digitalWrite(DIRECTION[i], wanted[i] > stepped[i]);
        digitalWrite(STEP[i], HIGH);
        delayMicroseconds(2);
        digitalWrite(STEP[i], LOW);
        stepped[i] += wanted[i] > stepped[i] ? 1 : -1;
    }
}
