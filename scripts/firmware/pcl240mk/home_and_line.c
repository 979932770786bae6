/* home_and_line.c: homes three axes and moves them along a straight line. One PCL-240MK per 4 ports, from 300h on. */
#include "hal.h"
#include "line.h"
#include "pcl240.h"

#define AXES 3
#define FIRST_PORT 0x300
#define PORTS 4
#define APPROACH 102 /* 400 pps */
#define BACK_OFF 200 /* pulses */
#define HOME_MS 30000
#define LINE_MS 10000
#define SETTLE_US 100000

enum { NO_CHIP = 10, NOT_HOMED = 20, NO_LINE = 30, NOT_THERE = 40 }; /* and the axis */

static const char axis[AXES + 1] = "xyz";
static const struct pcl240_speed speed = {255, 4080, 193, 193, 153}; /* 1000 to 16000 pps in 150 ms */
static const int32_t line[AXES] = {20000, 12000, 5000}; /* pulses from the origin */

int application(void)
{
    struct pcl240 chip[AXES];
    struct pcl240_move move[AXES];
    int k, result;

    for (k = 0; k < AXES; k++)
        if (pcl240_open(&chip[k], (uint16_t)(FIRST_PORT + k * PORTS)) != PCL240_OK) {
            hal_log("%c: no chip at %03Xh", axis[k], (unsigned)chip[k].port);
            return NO_CHIP + k;
        }
    for (k = 0; k < AXES; k++) {
        result = pcl240_home(&chip[k], &speed, APPROACH, BACK_OFF, HOME_MS);
        if (result != PCL240_OK) {
            hal_log("%c: no origin (%d)", axis[k], result);
            return NOT_HOMED + k;
        }
        hal_log("%c: homed", axis[k]);
    }
    result = line_plan(AXES, line, &speed, move);
    if (result != LINE_OK) {
        hal_log("no registers make this line (%d)", result);
        return NO_LINE;
    }
    hal_delay_us(SETTLE_US);
    hal_log("line");
    line_start(AXES, chip, move);
    result = line_finish(AXES, chip, move, LINE_MS);
    hal_delay_us(SETTLE_US);
    for (k = 0; k < AXES; k++) {
        hal_log("%c: at %ld", axis[k], (long)pcl240_position(&chip[k]));
        if (result != PCL240_OK || pcl240_position(&chip[k]) != line[k])
            return NOT_THERE + k;
    }
    return 0;
}
