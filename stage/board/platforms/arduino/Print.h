/* Print.h on an emulated board: HardwareSerial.h has the class Print. */
#include <Arduino.h>
