/* settings.c: numbers of the machine, under the numbers that grbl gives them. */
#include "settings.h"

#include "serial.h"

struct settings settings = {
    .junction_deviation = 0.01f,
    .arc_tolerance = 0.002f,
    .hard_limits = 1,
    .homes_to_minus = 3,
    .homing_feed = 120,
    .homing_seek = 2400,
    .homing_pull_off = 1,
    .steps_per_mm = {320, 320, 320},
    .max_rate = {4500, 4500, 3000},
    .acceleration = {500, 500, 300},
    .travel = {300, 200, 80},
};

static const struct {
    uint8_t number;
    float *value;
} table[] = {
    {11, &settings.junction_deviation},
    {12, &settings.arc_tolerance},
    {21, &settings.hard_limits},
    {23, &settings.homes_to_minus},
    {24, &settings.homing_feed},
    {25, &settings.homing_seek},
    {27, &settings.homing_pull_off},
    {100, &settings.steps_per_mm[0]},
    {101, &settings.steps_per_mm[1]},
    {102, &settings.steps_per_mm[2]},
    {110, &settings.max_rate[0]},
    {111, &settings.max_rate[1]},
    {112, &settings.max_rate[2]},
    {120, &settings.acceleration[0]},
    {121, &settings.acceleration[1]},
    {122, &settings.acceleration[2]},
    {130, &settings.travel[0]},
    {131, &settings.travel[1]},
    {132, &settings.travel[2]},
};
#define COUNT (sizeof table / sizeof table[0])

bool settings_set(float number, float value)
{
    for (uint8_t k = 0; k < COUNT; k++)
        if (table[k].number == number && (value > 0 || (value == 0 && number > 20 && number < 24))) {
            *table[k].value = value;
            return true;
        }
    return false;
}

void settings_print(void)
{
    for (uint8_t k = 0; k < COUNT; k++) {
        serial_print("$");
        serial_print_integer(table[k].number);
        serial_print("=");
        serial_print_decimal(*table[k].value);
        serial_print("\r\n");
    }
}
