// hctl1100_home.ino: an HCTL-1100 on the pins of an Arduino Uno. It finds the home switch, wired to STOP, and then moves 20 mm.
// Nothing here knows of an emulated board.

const byte DATA[8] = {2, 3, 4, 5, 6, 7, 8, 9};
const byte ALE = 10, CS = 11, RW = 12, OE = 13;

const byte FLAGS = 0x00, MODE = 0x05, STATUS = 0x07, TIMER = 0x0F;
const byte STOP_CLEAR = 0x40; // of the status: STOP has not triggered

enum State { SEARCHING, MOVING, DONE };
State state = SEARCHING;

void setup() {
  Serial.begin(115200);
  for (byte pin : {ALE, CS, RW, OE}) {
    digitalWrite(pin, HIGH);
    pinMode(pin, OUTPUT);
  }
  tune();
  command(0x0E, 0); // where the axis is now, with R13 written
  writeRegister(0x3C, 0);
  writeRegister(MODE, 0x03);
  writeRegister(FLAGS, 0x0D); // F5: integral velocity
  writeRegister(0x26, 0x40);  // acceleration
  writeRegister(0x27, 0);
  writeRegister(0x3C, byte(-4)); // counts a sample, towards the switch
  Serial.println(F("searching"));
}

void loop() {
  switch (state) {
  case SEARCHING:
    if (!(readRegister(STATUS) & STOP_CLEAR)) {
      delay(100);
      writeRegister(FLAGS, 0x05);
      writeRegister(MODE, 0x01); // Init/Idle
      Serial.print("home at ");
      Serial.println(position());
      writeRegister(0x13, 0); // here is 0
      command(0x0E, 0);
      writeRegister(MODE, 0x03);
      start(4000);
      state = MOVING;
    }
    break;
  case MOVING:
    if (!(readRegister(FLAGS) & 0x01)) {
      delay(200);
      Serial.print("at ");
      Serial.println(position());
      state = DONE;
    }
    break;
  case DONE:
    delay(1000);
    break;
  }
}

void tune() {
  writeRegister(MODE, 0x01);
  writeRegister(TIMER, 0x0F);
  writeRegister(0x20, 0xE5);
  writeRegister(0x21, 0x40);
  writeRegister(0x22, 0x20);
  writeRegister(0x13, 0);
}

// a 24-bit number in three registers, the lowest byte at `low`, which goes last
void command(byte low, long value) {
  writeRegister(low - 2, value >> 16);
  writeRegister(low - 1, value >> 8);
  writeRegister(low, value);
}

void start(long target) {
  writeRegister(0x29, target);
  writeRegister(0x2A, target >> 8);
  writeRegister(0x2B, target >> 16);
  writeRegister(0x26, 4);
  writeRegister(0x27, 0);
  writeRegister(0x28, 4);
  writeRegister(FLAGS, 0x08); // F0: trapezoid
}

long position() {
  long value = readRegister(0x14); // the low byte latches the others
  value |= long(readRegister(0x13)) << 8;
  value |= long(int8_t(readRegister(0x12))) * 65536;
  return value;
}

void direction(byte mode) {
  for (byte k = 0; k < 8; k++)
    pinMode(DATA[k], mode);
}

void put(byte value) {
  for (byte k = 0; k < 8; k++)
    digitalWrite(DATA[k], bitRead(value, k));
}

void address(byte number) {
  direction(OUTPUT);
  put(number);
  digitalWrite(ALE, LOW);
  digitalWrite(ALE, HIGH);
}

void writeRegister(byte number, byte value) {
  address(number);
  put(value);
  digitalWrite(RW, LOW);
  digitalWrite(CS, LOW);
  digitalWrite(CS, HIGH);
  digitalWrite(RW, HIGH);
}

byte readRegister(byte number) {
  byte value = 0;
  address(number);
  direction(INPUT);
  digitalWrite(CS, LOW);
  digitalWrite(CS, HIGH);
  digitalWrite(OE, LOW);
  delayMicroseconds(2);
  for (byte k = 0; k < 8; k++)
    bitWrite(value, k, digitalRead(DATA[k]));
  digitalWrite(OE, HIGH);
  return value;
}
