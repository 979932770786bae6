/* machine.c: the states of the machine, and the commands of the host. */
#include "machine.h"

#include "gcode.h"
#include "hal.h"
#include "homing.h"
#include "planner.h"
#include "serial.h"
#include "settings.h"
#include "stepper.h"

#define RESET 0x18 /* Ctrl-X */

static volatile enum alarm alarm;
static volatile bool wants_status, wants_reset, alarm_is_new, homing;

bool machine_take_realtime_command(char byte)
{
    switch (byte) {
    case '?':
        wants_status = true;
        return true;
    case '!':
        if (stepper_is_moving() && !homing)
            stepper_hold();
        return true;
    case '~':
        stepper_resume();
        return true;
    case RESET:
        if (stepper_is_moving())
            machine_raise_alarm(ALARM_RESET);
        wants_reset = true;
        return true;
    default:
        return false;
    }
}

void machine_raise_alarm(enum alarm new_alarm)
{
    stepper_abort();
    alarm = new_alarm;
    alarm_is_new = true;
}

void machine_check_limits(void)
{
    if (hal_read_limits() && !homing && settings.hard_limits && alarm == NO_ALARM)
        machine_raise_alarm(ALARM_HARD_LIMIT);
}

bool machine_is_locked(void) { return alarm != NO_ALARM; }

void machine_unlock(void)
{
    stepper_recover();
    gcode_reset();
    alarm = NO_ALARM;
}

void machine_set_homing(bool on) { homing = on; }

static const char *get_state(void)
{
    return alarm ? "Alarm" : homing ? "Home" : stepper_is_holding() ? "Hold" : stepper_is_moving() ? "Run" : "Idle";
}

static void print_status(void)
{
    uint8_t limits = hal_read_limits();
    serial_print("<");
    serial_print(get_state());
    for (uint8_t axis = 0; axis < AXES; axis++) {
        serial_print(axis ? "," : "|MPos:");
        serial_print_decimal((float)stepper_get_position(axis) / settings.steps_per_mm[axis]);
    }
    serial_print("|Rate:");
    serial_print_integer(stepper_get_rate());
    if (limits)
        serial_print("|Pn:");
    for (uint8_t axis = 0; axis < AXES; axis++)
        if (limits >> axis & 1)
            hal_send("XYZ"[axis]);
    serial_print(">\r\n");
}

bool machine_wait(void)
{
    hal_idle();
    if (wants_status) {
        wants_status = false;
        print_status();
    }
    if (alarm_is_new) {
        alarm_is_new = false;
        serial_print("ALARM:");
        serial_print_integer(alarm);
        serial_print("\r\n");
    }
    return !wants_reset && !alarm;
}

bool machine_wait_for_rest(void)
{
    while (stepper_is_moving() || stepper_is_holding())
        if (!machine_wait())
            return false;
    return true;
}

static void reset(void)
{
    wants_reset = false;
    homing = false;
    stepper_seek(AXES);
    if (!alarm) {
        stepper_abort();
        stepper_recover();
    }
    serial_clear();
    gcode_reset();
    serial_print("\r\nPulseStage G-code 1 ['$' for help]\r\n");
}

static enum result run_dollar_line(const char *line)
{
    float number, value;
    if (line[1] == 0) {
        serial_print("[HLP:$$ $n=value $H $X ~ ! ? ctrl-x]\r\n");
        return RESULT_OK;
    }
    if (stepper_is_moving() || stepper_is_holding())
        return RESULT_NOT_IDLE;
    if (line[2] == 0 && line[1] == '$') {
        settings_print();
        return RESULT_OK;
    }
    if (line[2] == 0 && line[1] == 'X') {
        machine_unlock();
        return RESULT_OK;
    }
    if (line[2] == 0 && line[1] == 'H')
        return home_all_axes() ? RESULT_OK : RESULT_ABORTED;
    line++;
    if (gcode_parse_number(&line, &number) && *line++ == '=' && gcode_parse_number(&line, &value) && *line == 0)
        return settings_set(number, value) ? RESULT_OK : RESULT_BAD_VALUE;
    return RESULT_BAD_STATEMENT;
}

static void run_line(enum line_result kind, const char *line)
{
    enum result result = kind == LINE_TOO_LONG ? RESULT_LINE_TOO_LONG
                         : line[0] == '$'      ? run_dollar_line(line)
                         : machine_is_locked() && line[0] ? RESULT_LOCKED
                                                          : gcode_run_line(line);
    if (result == RESULT_ABORTED)
        return;
    serial_print(result == RESULT_OK ? "ok" : "error:");
    if (result != RESULT_OK)
        serial_print_integer(result);
    serial_print("\r\n");
}

void machine_run(void)
{
    static char line[LINE_LENGTH];
    stepper_seek(AXES);
    wants_reset = true;
    for (;;) {
        enum line_result kind;
        machine_wait();
        if (wants_reset)
            reset();
        kind = serial_read_line(line);
        if (kind != NO_LINE)
            run_line(kind, line);
    }
}
