/* wiring_private.h on an emulated board: libraries include it for cbi, sbi and the registers. */
#include <Arduino.h>
#ifndef sbi
#define sbi(sfr, bit) ((sfr) |= _BV(bit))
#endif
#ifndef cbi
#define cbi(sfr, bit) ((sfr) &= (uint8_t)~_BV(bit))
#endif
