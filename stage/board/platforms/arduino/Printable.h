/* Printable.h on an emulated board: HardwareSerial.h has the class Printable. */
#include <Arduino.h>
