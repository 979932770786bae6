/* homing.h: finds the zero of each axis at its limit switch. */
#ifndef HOMING_H
#define HOMING_H

#include <stdbool.h>

bool home_all_axes(void); /* false: an alarm or a reset ended it */

#endif
