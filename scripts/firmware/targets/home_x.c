/* home_x.c: homes one axis and moves it 6000 pulses. One PCL-240MK at 300h. */
#include "hal.h"
#include "pcl240.h"

#define PORT 0x300
#define APPROACH 102 /* 400 pps */
#define BACK_OFF 200 /* pulses */
#define HOME_MS 30000
#define MOVE_MS 10000
#define SETTLE_US 100000

static const struct pcl240_speed speed = {255, 4080, 193, 193, 153}; /* 1000 to 16000 pps in 150 ms */

int application(void)
{
    struct pcl240 chip;
    struct pcl240_move move;
    int result;

    if (pcl240_open(&chip, PORT) != PCL240_OK)
        return 1;
    result = pcl240_home(&chip, &speed, APPROACH, BACK_OFF, HOME_MS);
    hal_log("homed (%d), int has %d bytes", result, (int)sizeof(int));
    if (result != PCL240_OK)
        return 2;
    move.pulses = 6000;
    move.speed = speed;
    move.down_point = pcl240_down_point(&speed);
    result = pcl240_move(&chip, &move, MOVE_MS);
    hal_delay_us(SETTLE_US);
    hal_log("moved (%d), at %ld", result, (long)pcl240_position(&chip));
    return result == PCL240_OK ? 0 : 3;
}
