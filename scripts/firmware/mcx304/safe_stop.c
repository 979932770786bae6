/* safe_stop.c: the work-arounds of NOVA's notice for case 1. */
#include "safe_stop.h"

void safe_stop_arm(struct safe_stop *stop, struct mcx304 *chip, int axis, uint16_t wr1)
{
    stop->chip = chip;
    stop->axis = axis;
    stop->wr1 = wr1;
    stop->prohibited = 0;
    mcx304_status(chip, axis, 3); /* factors of the drive before */
    mcx304_mode(chip, axis, 1, wr1 | MCX304_WR1_C_END);
}

/* It comes between any two bus cycles of the task, and leaves the axis selected that it found. */
void safe_stop_interrupt(void *argument)
{
    struct safe_stop *stop = argument;
    uint16_t selected = stop->chip->selected;
    int axis;

    if (mcx304_status(stop->chip, stop->axis, 3) & MCX304_RR3_C_END) {
        stop->prohibited = 1;
        mcx304_mode(stop->chip, stop->axis, 1, stop->wr1); /* CNST comes once more, at the end */
    }
    for (axis = 0; axis < MCX304_AXES; axis++)
        if (selected == 0x100 << axis)
            mcx304_command(stop->chip, axis, MCX304_NOP);
}

int safe_stop_by_flag(struct safe_stop *stop)
{
    if (stop->prohibited)
        return 0;
    mcx304_command(stop->chip, stop->axis, MCX304_DECELERATING_STOP);
    return 1;
}

int safe_stop_by_speed(struct mcx304 *chip, int axis, uint16_t initial, uint16_t drive)
{
    uint16_t judgmental = (uint16_t)((drive - initial) / 2 + initial);

    if (!(mcx304_status(chip, axis, 1) & (MCX304_RR1_ASND | MCX304_RR1_CNST)))
        return 0;
    if (mcx304_speed(chip, axis) < judgmental)
        return 0;
    mcx304_command(chip, axis, MCX304_DECELERATING_STOP);
    return 1;
}
