/* pins_arduino.h: the pins of an Arduino Uno, or with -DARDUINO_AVR_MEGA2560 of a Mega 2560, as bits of the microcontroller's ports. */
#ifndef PULSESTAGE_PINS_ARDUINO_H
#define PULSESTAGE_PINS_ARDUINO_H

extern "C++" { /* also where a program in C is included */

#include <pulsestage.h>
#include <stdint.h>

#if defined(ARDUINO_AVR_MEGA2560)
#define NUM_DIGITAL_PINS 70
#define PULSESTAGE_ANALOG 54
#define SS 53
#define MOSI 51
#define MISO 50
#define SCK 52
#define SDA 20
#define SCL 21
#else
#define NUM_DIGITAL_PINS 20
#define PULSESTAGE_ANALOG 14
#define SS 10
#define MOSI 11
#define MISO 12
#define SCK 13
#define SDA 18
#define SCL 19
#endif
#define LED_BUILTIN 13

enum {
    A0 = PULSESTAGE_ANALOG, A1, A2, A3, A4, A5, A6, A7, A8, A9, A10, A11, A12, A13, A14, A15
};

/* The pins of the board by their numbers, for the check of --pins: how many they are, and the bit of the ports that each of them is;
 * port A's bit 0 is 0. */
extern "C" {
extern uint8_t pulsestage_board_pins[71];
#define P(letter, bit) (((letter) - 'A') * 8 + (bit))
#if defined(ARDUINO_AVR_MEGA2560)
PULSESTAGE_SHARED uint8_t pulsestage_board_pins[71] = {NUM_DIGITAL_PINS,
    P('E', 0), P('E', 1), P('E', 4), P('E', 5), P('G', 5), P('E', 3), P('H', 3), P('H', 4), P('H', 5), P('H', 6),
    P('B', 4), P('B', 5), P('B', 6), P('B', 7), P('J', 1), P('J', 0), P('H', 1), P('H', 0), P('D', 3), P('D', 2),
    P('D', 1), P('D', 0), P('A', 0), P('A', 1), P('A', 2), P('A', 3), P('A', 4), P('A', 5), P('A', 6), P('A', 7),
    P('C', 7), P('C', 6), P('C', 5), P('C', 4), P('C', 3), P('C', 2), P('C', 1), P('C', 0), P('D', 7), P('G', 2),
    P('G', 1), P('G', 0), P('L', 7), P('L', 6), P('L', 5), P('L', 4), P('L', 3), P('L', 2), P('L', 1), P('L', 0),
    P('B', 3), P('B', 2), P('B', 1), P('B', 0), P('F', 0), P('F', 1), P('F', 2), P('F', 3), P('F', 4), P('F', 5),
    P('F', 6), P('F', 7), P('K', 0), P('K', 1), P('K', 2), P('K', 3), P('K', 4), P('K', 5), P('K', 6), P('K', 7),
};
#else
PULSESTAGE_SHARED uint8_t pulsestage_board_pins[71] = {NUM_DIGITAL_PINS,
    P('D', 0), P('D', 1), P('D', 2), P('D', 3), P('D', 4), P('D', 5), P('D', 6), P('D', 7), P('B', 0), P('B', 1),
    P('B', 2), P('B', 3), P('B', 4), P('B', 5), P('C', 0), P('C', 1), P('C', 2), P('C', 3), P('C', 4), P('C', 5),
};
#endif
#undef P
}

namespace pulsestage
{
/* The bit of the ports that a pin of the board is. Pins that the board does not have are bits of no real port. */
inline int core_pin(int pin)
{
    return pin >= 0 && pin < NUM_DIGITAL_PINS ? pulsestage_board_pins[1 + pin] : 96 + (pin & 31);
}
} // namespace pulsestage

} /* extern "C++" */
#endif
