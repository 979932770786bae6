/* settings.h: numbers of the machine that the host may change by $NUMBER=VALUE; at power-up they are those of settings.c. */
#ifndef SETTINGS_H
#define SETTINGS_H

#include <stdbool.h>
#include <stdint.h>

#include "hal.h"

struct settings {
    float junction_deviation;          /* mm */
    float arc_tolerance;               /* mm */
    float hard_limits;                 /* 0: a limit switch does not stop a move */
    float homes_to_minus;              /* mask of axes */
    float homing_feed;                 /* mm/min, of the second approach */
    float homing_seek;                 /* mm/min, of the first approach */
    float homing_pull_off;             /* mm */
    float steps_per_mm[AXES];
    float max_rate[AXES];              /* mm/min */
    float acceleration[AXES];          /* mm/s2 */
    float travel[AXES];                /* mm, that homing searches one and a half times */
};

extern struct settings settings;

bool settings_set(float number, float value); /* false: no such setting, or no such value */
void settings_print(void);

#endif
