/* The firmware on a PC: standard input and output are its serial line, its axes follow at once. For tests.
 *
 * cc -std=c99 -D_POSIX_C_SOURCE=200809L -I../struts main.c ../struts/struts.c -o struts
 * struts [NM ..]   where the axes truly stand at first; a switch closes at 0
 */
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "struts.h"

#define AXES 6

static int32_t counted[AXES], truly[AXES];
static bool ended;

static uint32_t now_ms(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint32_t)((uint64_t)now.tv_sec * 1000 + (uint64_t)now.tv_nsec / 1000000);
}

static uint32_t a_boot(void)
{
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    return (uint32_t)now.tv_nsec ^ (uint32_t)now.tv_sec ^ (uint32_t)getpid() << 16;
}

static int next_byte(void)
{
    unsigned char byte;
    ssize_t got = read(STDIN_FILENO, &byte, 1);
    if (got == 1)
        return byte;
    if (got == 0 || (errno != EAGAIN && errno != EINTR))
        ended = true;
    return -1;
}

static void say(const char *text)
{
    size_t left = strlen(text);
    while (left) {
        ssize_t put = write(STDOUT_FILENO, text, left);
        if (put < 0)
            return; /* nobody reads */
        text += put;
        left -= (size_t)put;
    }
}

/* The axis moves by as much as its count does; homing changes the count alone. */
static void follow(uint8_t axis, int32_t nm)
{
    truly[axis] += nm - counted[axis];
    counted[axis] = nm;
}

static bool on_switch(uint8_t axis)
{
    if (truly[axis] <= 0) {
        counted[axis] = truly[axis] = 0;
        return true;
    }
    return false;
}

static bool motor_fault(void)
{
    return false;
}

int main(int argc, char **argv)
{
    static const struts_board board = {
        AXES, "pc", {0}, {100000000, 100000000, 100000000, 100000000, 100000000, 100000000}, {0}, 50000, 120000000, 200,
        a_boot, now_ms, next_byte, say, follow, on_switch, motor_fault};
    for (int i = 0; i < AXES && i + 1 < argc; i++)
        truly[i] = (int32_t)atol(argv[i + 1]);
    fcntl(STDIN_FILENO, F_SETFL, fcntl(STDIN_FILENO, F_GETFL) | O_NONBLOCK);
    struts_setup(&board);
    while (!ended) {
        struct pollfd input = {STDIN_FILENO, POLLIN, 0};
        poll(&input, 1, 1);
        struts_loop();
    }
    return 0;
}
