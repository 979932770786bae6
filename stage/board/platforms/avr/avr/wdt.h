/* avr/wdt.h on an emulated board: no watchdog. */
#ifndef PULSESTAGE_AVR_WDT_H
#define PULSESTAGE_AVR_WDT_H

#define wdt_reset() ((void)0)
#define wdt_disable() ((void)0)
#define wdt_enable(time) ((void)(time))
enum { WDTO_15MS, WDTO_30MS, WDTO_60MS, WDTO_120MS, WDTO_250MS, WDTO_500MS, WDTO_1S, WDTO_2S };

#endif
