/* two_tasks.c: one task moves the X axis and polls until it has arrived; the other blinks a lamp at the OTS output of the Y axis. */
#include "../pcl240mk/pcl240.h"
#include "hal.h"
#include "scheduler.h"

#define LAMP 0x20 /* of the output mode: level of OTS */

static volatile int moving = 1;
static enum pcl240_result result;

static void move(void *argument)
{
    struct pcl240_move preset = {2000, {50, 400, 1500, 1500, 30}, 0};
    struct pcl240 *x = argument;
    preset.down_point = pcl240_down_point(&preset.speed);
    hal_log("move: start");
    result = pcl240_move(x, &preset, 5000);
    hal_log("move: done, result %d", (int)result);
    moving = 0;
}

static void blink(void *argument)
{
    int on = 0;
    while (moving) {
        on = !on;
        pcl240_command(argument, (uint8_t)(PCL240_OUTPUT | (on ? LAMP : 0)));
        hal_log("lamp %s", on ? "on" : "off");
        task_sleep(50);
    }
}

int application(void)
{
    static struct pcl240 x, y;
    if (pcl240_open(&x, 0x300) != PCL240_OK || pcl240_open(&y, 0x304) != PCL240_OK)
        return 10;
    task_create(move, &x);
    task_create(blink, &y);
    scheduler_run();
    return (int)result;
}
