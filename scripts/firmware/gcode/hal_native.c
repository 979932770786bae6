/* hal_native.c: the same firmware on a PC, in simulated time in which computing takes none.
 *
 *     cc *.c -lm -o gcode && ./gcode edges.txt < script     (without hal_atmega328p.c)
 *
 * Lines of the script go to the firmware, each when the one before has been answered. Others are for this file:
 *
 *     @run 0.25         let 0.25 s pass
 *     @send !           send characters at once, without a line end
 *     @rest             wait until no step has come for 0.1 s
 *     @limits X -5 20   the limit switch of X is on from -5 mm down and from 20 mm up, of where it is at power-up
 *     @stuck X 1        that switch is on (1), off (0) or works again (-1)
 *
 * It prints what the firmware sends and, at the end of the script, the steps that each axis made, plus less minus. edges.txt gets a
 * line for each interrupt that makes steps: ticks, then the signed step of each axis.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "hal.h"
#include "machine.h"
#include "serial.h"
#include "stepper.h"

#define TICKS_PER_RAMP_UPDATE (TICKS_PER_SECOND / RAMP_UPDATES_PER_SECOND)
#define TICKS_PER_BYTE 174 /* 115200 baud */
#define REST_TICKS (TICKS_PER_SECOND / 10)
#define STEPS_PER_MM 320
#define MAX_STEPS 1000000000L

static uint64_t now, next_step, next_byte, last_step; /* ticks */
static uint8_t minus_axes;
static bool steps_run, waits_for_rest, waits_for_answer, script_has_ended;
static char to_send[256];
static size_t sent;
static char answer[128];
static FILE *edges;
static struct {
    long steps, minus_limit, plus_limit;
    int stuck; /* -1: not */
    bool was_on;
} axes[AXES];

static void finish(void)
{
    printf("steps %ld %ld %ld\n", axes[0].steps, axes[1].steps, axes[2].steps);
    if (edges)
        fclose(edges);
    exit(0);
}

static void wait_for_rest(void)
{
    waits_for_rest = true;
    last_step = now;
}

static void run_directive(const char *text)
{
    char axis;
    double a, b;
    if (sscanf(text, "@run %lf", &a) == 1) {
        next_byte = now + (uint64_t)(a * TICKS_PER_SECOND);
    } else if (strncmp(text, "@send ", 6) == 0) {
        snprintf(to_send, sizeof to_send, "%.*s", (int)strcspn(text + 6, "\n"), text + 6);
    } else if (strncmp(text, "@rest", 5) == 0) {
        wait_for_rest();
    } else if (sscanf(text, "@limits %c %lf %lf", &axis, &a, &b) == 3) {
        axes[axis - 'X'].minus_limit = (long)(a * STEPS_PER_MM);
        axes[axis - 'X'].plus_limit = (long)(b * STEPS_PER_MM);
    } else if (sscanf(text, "@stuck %c %lf", &axis, &a) == 2) {
        axes[axis - 'X'].stuck = (int)a;
    } else {
        fprintf(stderr, "what is %s", text);
        exit(2);
    }
}

/* Send the next byte of the script, or read its next line. */
static void go_on_with_script(void)
{
    char text[200];
    next_byte = now + TICKS_PER_BYTE;
    if (to_send[sent]) {
        serial_receive(to_send[sent++]);
        return;
    }
    waits_for_rest = waits_for_rest && now - last_step < REST_TICKS;
    if (waits_for_answer || waits_for_rest)
        return;
    sent = 0;
    to_send[0] = 0;
    if (script_has_ended)
        finish();
    if (!fgets(text, sizeof text, stdin)) {
        script_has_ended = true;
        wait_for_rest();
    } else if (text[0] == '@') {
        run_directive(text);
    } else {
        strcpy(to_send, text);
        waits_for_answer = true;
    }
}

static void watch_limits(void)
{
    bool changed = false;
    for (int k = 0; k < AXES; k++) {
        bool is_on = hal_read_limits() >> k & 1;
        changed |= is_on != axes[k].was_on;
        axes[k].was_on = is_on;
    }
    if (changed)
        machine_check_limits();
}

void hal_idle(void)
{
    static uint64_t next_ramp_update = TICKS_PER_RAMP_UPDATE;
    uint64_t next = next_byte < next_ramp_update ? next_byte : next_ramp_update;
    bool is_step = steps_run && next_step <= next;
    fflush(stdout);
    now = is_step ? next_step : next;
    if (is_step) {
        uint16_t ticks = stepper_make_step();
        steps_run = ticks != 0;
        next_step += ticks;
    } else if (now == next_ramp_update) {
        next_ramp_update += TICKS_PER_RAMP_UPDATE;
        stepper_update_rate();
    } else {
        go_on_with_script();
    }
    watch_limits();
}

void hal_send(char byte)
{
    size_t length = strlen(answer);
    putchar(byte);
    if (byte != '\n' && length < sizeof answer - 1) {
        answer[length] = byte;
        answer[length + 1] = 0;
        return;
    }
    if (strncmp(answer, "ok", 2) == 0 || strncmp(answer, "error", 5) == 0 || strncmp(answer, "ALARM", 5) == 0)
        waits_for_answer = false;
    answer[0] = 0;
}

uint32_t hal_get_milliseconds(void) { return (uint32_t)(now / (TICKS_PER_SECOND / 1000)); }
uint8_t hal_lock(void) { return 0; }
void hal_unlock(uint8_t key) { (void)key; }
void hal_set_directions(uint8_t minus) { minus_axes = minus; }
void hal_lower_steps(void) {}

void hal_raise_steps(uint8_t mask)
{
    int made[AXES];
    for (int k = 0; k < AXES; k++) {
        made[k] = mask >> k & 1 ? (minus_axes >> k & 1 ? -1 : 1) : 0;
        axes[k].steps += made[k];
    }
    last_step = now;
    if (edges)
        fprintf(edges, "%llu %d %d %d\n", (unsigned long long)now, made[0], made[1], made[2]);
}

uint8_t hal_read_limits(void)
{
    uint8_t on = 0;
    for (int k = 0; k < AXES; k++)
        if (axes[k].stuck >= 0 ? axes[k].stuck
                               : axes[k].steps <= axes[k].minus_limit || axes[k].steps >= axes[k].plus_limit)
            on |= (uint8_t)(1 << k);
    return on;
}

void hal_start_step_timer(uint16_t ticks)
{
    steps_run = true;
    next_step = now + ticks;
}

void hal_stop_step_timer(void) { steps_run = false; }

void hal_init(void)
{
    for (int k = 0; k < AXES; k++) {
        axes[k].stuck = -1;
        axes[k].minus_limit = -MAX_STEPS;
        axes[k].plus_limit = MAX_STEPS;
    }
}

int main(int count, char **arguments)
{
    edges = count > 1 ? fopen(arguments[1], "w") : 0;
    hal_init();
    machine_run();
}
