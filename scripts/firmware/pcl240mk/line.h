/* line.h: the a:b move, several PCL-240MK on one straight line. */
#ifndef LINE_H
#define LINE_H

#include "pcl240.h"

#define LINE_MOST_AXES 8

enum line_result {
    LINE_OK,
    LINE_TOO_LONG,  /* R0 counts to 16777215, R6 to 1048575 */
    LINE_TOO_SHORT, /* no room for the ramps: ask for a lower FH1 or for steeper ramps */
    LINE_TOO_SLOW   /* the rate of a short axis is none that a chip makes: ask for a higher FH1, or move it alone */
};

/* Registers for every axis of a line. distance: pulses, signed, 0 for an axis that stands still. speed: of the longest axis. */
enum line_result line_plan(int axes, const int32_t distance[], const struct pcl240_speed *speed,
                           struct pcl240_move move[]);

/* Write them to the chips and start those that move: the shortest first, the longest last. */
void line_start(int axes, const struct pcl240 chip[], const struct pcl240_move move[]);

/* Wait for all. If one is stopped on its way the others are, too: the line is lost. So they are after timeout_ms. */
enum pcl240_result line_finish(int axes, const struct pcl240 chip[], const struct pcl240_move move[],
                               uint32_t timeout_ms);

#endif
