/* Homing without a switch: a TMC2209 at Serial1 and at pins, without a library.
 *
 *   stage run stallguard_homing.ino --for 8 --chips stepdir --drive tmc2209 --allow-lost-steps x=8 \
 *       --pins x.step=2,x.dir=5,x.enable=!8,x.diag=9,x.uart=Serial1
 */
const int STEP = 2, DIR = 5, ENABLE = 8, DIAG = 9;
const uint8_t ADDRESS = 3; /* MS1 and MS2 high: 16 microsteps */
const uint8_t GCONF = 0x00, IFCNT = 0x02, IHOLD_IRUN = 0x10, TCOOLTHRS = 0x14, SGTHRS = 0x40, SG_RESULT = 0x41;

volatile bool is_stalled;

uint8_t compute_crc(const uint8_t *bytes, int count)
{
    uint8_t crc = 0;
    for (int k = 0; k < count; k++)
        for (uint8_t bit = 0, byte = bytes[k]; bit < 8; bit++, byte >>= 1)
            crc = (crc >> 7) ^ (byte & 1) ? (crc << 1) ^ 7 : crc << 1;
    return crc;
}

void write_register(uint8_t number, uint32_t value)
{
    uint8_t datagram[8] = {0x05, ADDRESS, uint8_t(number | 0x80)};
    for (int k = 0; k < 4; k++)
        datagram[3 + k] = value >> 8 * (3 - k);
    datagram[7] = compute_crc(datagram, 7);
    Serial1.write(datagram, 8);
    delay(2);
}

long read_register(uint8_t number)
{
    uint8_t datagram[4] = {0x05, ADDRESS, number}, reply[12];
    while (Serial1.available())
        Serial1.read();
    datagram[3] = compute_crc(datagram, 3);
    Serial1.write(datagram, 4);
    /* the wire returns the 4 bytes of the request before the 8 of the reply */
    if (Serial1.readBytes(reply, 12) < 12 || compute_crc(reply + 4, 7) != reply[11])
        return -1;
    return (long)reply[7] << 24 | (long)reply[8] << 16 | (long)reply[9] << 8 | reply[10];
}

void make_step(unsigned period_us)
{
    digitalWrite(STEP, HIGH);
    delayMicroseconds(3);
    digitalWrite(STEP, LOW);
    delayMicroseconds(period_us - 3);
}

void on_stall() { is_stalled = true; }

void setup()
{
    Serial.begin(115200);  /* the log of the run */
    Serial1.begin(115200); /* the chip */
    Serial1.setTimeout(20);
    pinMode(STEP, OUTPUT);
    pinMode(DIR, OUTPUT);
    pinMode(ENABLE, OUTPUT);
    pinMode(DIAG, INPUT);
    digitalWrite(ENABLE, LOW);
    digitalWrite(DIR, LOW);

    write_register(GCONF, 1 << 0 | 1 << 6 | 1 << 8); /* i_scale_analog, pdn_disable, multistep_filt */
    write_register(IHOLD_IRUN, 8L << 16 | 31 << 8 | 8);
    write_register(TCOOLTHRS, 100); /* TSTEP is 78 at 9,600 steps per second */
    write_register(SGTHRS, 30);
    Serial.print("writes that the chip has understood: ");
    Serial.println(read_register(IFCNT));

    for (unsigned period_us = 500; period_us > 104; period_us -= 12)
        for (int k = 0; k < 32; k++)
            make_step(period_us);
    attachInterrupt(digitalPinToInterrupt(DIAG), on_stall, RISING);
    long steps = 0;
    while (!is_stalled && steps < 60000) {
        make_step(104);
        steps++;
    }
    Serial.println(is_stalled ? "at the stop" : "no stall");
    Serial.print("SG_RESULT ");
    Serial.println(read_register(SG_RESULT));
}

void loop() { delay(10); }
