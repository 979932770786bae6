/* Stream.h on an emulated board: HardwareSerial.h has the class Stream. */
#include <Arduino.h>
