/* SoftwareSerial.h on an emulated board: a port on any two pins. The first object of a sketch has the board's serial line 4, the next
 * line 5, and so on up to 7 (docs/serial.md); the levels of its pins do not change. Several ports receive at one time. */
#ifndef PULSESTAGE_SOFTWARESERIAL_H
#define PULSESTAGE_SOFTWARESERIAL_H

extern "C++" { /* also where a program in C is included */

#include <Arduino.h>

class SoftwareSerial : public HardwareSerial
{
  public:
    SoftwareSerial(uint8_t receive_pin, uint8_t transmit_pin, bool inverted = false) : HardwareSerial(next_line())
    {
        (void)receive_pin, (void)transmit_pin, (void)inverted;
    }
    bool listen() { return false; } /* another port did not listen before */
    bool isListening() { return true; }
    bool stopListening() { return true; }
    bool overflow() { return false; }

  private:
    static int next_line()
    {
        static int line = 3;
        return line += line < pulsestage::SERIAL_LINES - 1; /* more objects share the last line */
    }
};

} /* extern "C++" */
#endif
