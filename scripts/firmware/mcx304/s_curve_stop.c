/* s_curve_stop.c: an S-curve drive of the X axis, and somebody who presses stop when STOP_AT pulses are left.
 *
 *     -DWORK_AROUND=0   26h, as one would write it                 (the default: it meets the failure)
 *     -DWORK_AROUND=1   the notice's case 1 (1), by interrupt
 *     -DWORK_AROUND=2   the notice's case 1 (2), by speed
 */
#include "hal.h"
#include "mcx304.h"
#include "safe_stop.h"

#ifndef WORK_AROUND
#define WORK_AROUND 0
#endif
#ifndef STOP_AT
#define STOP_AT 80
#endif

#define PORT 0x300
#define X 0
#define PULSES 40000
#define INITIAL_SPEED 400 /* times 10 pps */
#define DRIVE_SPEED 2000

enum { ON_TARGET, NO_CHIP = 10, STOPPED_BEFORE = 20 };

static struct mcx304 chip;
static struct safe_stop stop;

static void set_up(void)
{
    mcx304_load(&chip, X, MCX304_R, 800000); /* multiple 10 */
    mcx304_load(&chip, X, MCX304_K, 20000);
    mcx304_load(&chip, X, MCX304_A, 8000);
    mcx304_load(&chip, X, MCX304_SV, INITIAL_SPEED);
    mcx304_load(&chip, X, MCX304_V, DRIVE_SPEED);
    mcx304_load(&chip, X, MCX304_AO, 0);
    mcx304_load(&chip, X, MCX304_LP, 0);
    mcx304_mode(&chip, X, 2, MCX304_WR2_LIMITS_DECELERATE);
    mcx304_mode(&chip, X, 3, MCX304_WR3_S_CURVE);
}

static int ask_for_a_stop(void)
{
    switch (WORK_AROUND) {
    case 1:
        return safe_stop_by_flag(&stop);
    case 2:
        return safe_stop_by_speed(&chip, X, INITIAL_SPEED, DRIVE_SPEED);
    default:
        mcx304_command(&chip, X, MCX304_DECELERATING_STOP);
        return 1;
    }
}

int application(void)
{
    int given;

    if (mcx304_open(&chip, PORT)) {
        hal_log("no chip at %03Xh", PORT);
        return NO_CHIP;
    }
    set_up();
    if (WORK_AROUND == 1) {
        safe_stop_arm(&stop, &chip, X, 0);
        hal_on_interrupt(safe_stop_interrupt, &stop);
    }
    mcx304_start(&chip, X, PULSES);
    while (PULSES - mcx304_position(&chip, X) > STOP_AT)
        hal_delay_us(1000);
    given = ask_for_a_stop();
    hal_log("stop at %ld: %s", (long)mcx304_position(&chip, X), given ? "26h" : "it decelerates anyway");
    while (mcx304_driving(&chip, X))
        hal_delay_us(1000);
    hal_log("at %ld", (long)mcx304_position(&chip, X));
    return mcx304_position(&chip, X) == PULSES ? ON_TARGET : STOPPED_BEFORE;
}
