/* homing.c: each axis searches its limit switch, pulls off, approaches it again slowly, and pulls off. Z is the first, so that the
 * tool is out of the way. The place where the switch comes on in the slow approach is 0.
 */
#include "homing.h"

#include "gcode.h"
#include "hal.h"
#include "machine.h"
#include "planner.h"
#include "settings.h"
#include "stepper.h"

static bool move_axis(uint8_t axis, int32_t to, float feed)
{
    int32_t target[AXES];
    for (uint8_t k = 0; k < AXES; k++)
        target[k] = stepper_get_position(k);
    target[axis] = to;
    planner_add_line(target, feed / 60);
    stepper_start();
    return machine_wait_for_rest();
}

/* Go at most so many steps until the switch is on. */
static bool search_switch(uint8_t axis, int32_t steps, float feed)
{
    stepper_seek(axis);
    bool completed = move_axis(axis, stepper_get_position(axis) + steps, feed), found = stepper_has_found_switch();
    stepper_seek(AXES);
    if (completed && !found)
        machine_raise_alarm(ALARM_NO_SWITCH);
    return completed && found;
}

static bool pull_off(uint8_t axis, int32_t steps, float feed)
{
    bool completed = move_axis(axis, stepper_get_switch_position() + steps, feed);
    if (completed && hal_read_limits() >> axis & 1)
        machine_raise_alarm(ALARM_STUCK_SWITCH);
    return completed && !machine_is_locked();
}

static bool home_axis(uint8_t axis)
{
    float sign = (uint8_t)settings.homes_to_minus >> axis & 1 ? -1 : 1;
    int32_t off = (int32_t)(-sign * settings.homing_pull_off * settings.steps_per_mm[axis]);
    int32_t search = (int32_t)(1.5f * sign * settings.travel[axis] * settings.steps_per_mm[axis]);
    int32_t position[AXES];
    if (!search_switch(axis, search, settings.homing_seek) || !pull_off(axis, off, settings.homing_seek) ||
        !search_switch(axis, -2 * off, settings.homing_feed) || !pull_off(axis, off, settings.homing_seek))
        return false;
    for (uint8_t k = 0; k < AXES; k++)
        position[k] = stepper_get_position(k);
    position[axis] = off;
    stepper_set_position(position);
    return true;
}

bool home_all_axes(void)
{
    bool homed = true;
    machine_unlock();
    machine_set_homing(true);
    for (uint8_t axis = AXES; axis-- && homed;)
        homed = home_axis(axis);
    machine_set_homing(false);
    gcode_reset();
    return homed;
}
