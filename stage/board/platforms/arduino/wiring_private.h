/* wiring_private.h on an emulated board: libraries include it for cbi, sbi and the registers. */
#include <Arduino.h>
