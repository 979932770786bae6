/* SoftwareSerial.h on an emulated board: a port on any two pins. Its bytes are those of the board's one serial line, as Serial's are
 * (docs/serial.md); the levels of its pins do not change. */
#ifndef PULSESTAGE_SOFTWARESERIAL_H
#define PULSESTAGE_SOFTWARESERIAL_H

extern "C++" { /* also where a program in C is included */

#include <Arduino.h>

class SoftwareSerial : public HardwareSerial
{
  public:
    SoftwareSerial(uint8_t receive_pin, uint8_t transmit_pin, bool inverted = false)
    {
        (void)receive_pin, (void)transmit_pin, (void)inverted;
    }
    bool listen() { return false; } /* another port did not listen before */
    bool isListening() { return true; }
    bool stopListening() { return true; }
    bool overflow() { return false; }
};

} /* extern "C++" */
#endif
