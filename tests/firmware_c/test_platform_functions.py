"""Functions of the Arduino, VxWorks and DOS headers that access no port."""

import fnmatch
import tomllib
from pathlib import Path

import pytest

from stage import Stage
from stage.board import Board, HostTimeout, NativeHost, build
from stage.board.firmware_library import get_include_folder

ROOT = Path(__file__).resolve().parents[2]
CHECK = "#define CHECK(what) do { if (!(what)) return __LINE__; } while (0)\n"
MOVE = """
static void move(void (*out)(unsigned, unsigned), unsigned base)
{
    static const unsigned cycles[] = {0, 0x08, 0, 0x80, 1, 100, 0, 0x81, 1, 50, 0, 0x87, 1, 30, 0, 0x44, 0, 0x30};
    for (unsigned k = 0; k < sizeof cycles / sizeof *cycles; k += 2)
        out(base + cycles[k], cycles[k + 1]);
}
"""
"""100 pulses at FL, 1000 pps, with /INT at their end: after 100 ms."""

VXWORKS = (
    """
#include <vxWorks.h>
#include <semLib.h>
#include <msgQLib.h>
#include <intLib.h>
#include <taskLib.h>
#include <logLib.h>
#include <sysLib.h>
#include <wdLib.h>
"""
    + CHECK
    + MOVE
    + """
static SEM_ID done;
static int barks[2];
static WDOG_ID again;
static void bark(int which)
{
    barks[which]++;
    semGive(done);
    if (which == 1 && barks[1] < 3)
        wdStart(again, 2, (FUNCPTR)bark, 1);    /* periodic, as they are made */
}
static void wake(int unused) { (void)unused; semFlush(done); }
static int watchdogs(void)
{
    WDOG_ID w = wdCreate(), never = wdCreate();
    ULONG then = tickGet();
    int lock;
    again = wdCreate();
    CHECK(w && never && again && wdStart(0, 1, (FUNCPTR)bark, 0) == ERROR && wdCancel(0) == ERROR);
    CHECK(wdStart(w, 5, (FUNCPTR)bark, 0) == OK && wdStart(never, 7, (FUNCPTR)bark, 0) == OK && wdCancel(never) == OK);
    CHECK(semTake(done, 20) == OK && barks[0] == 1 && tickGet() - then >= 5 && tickGet() - then <= 6);
    taskDelay(10);
    CHECK(barks[0] == 1);                       /* once, and the cancelled one never */
    CHECK(wdStart(w, 3, (FUNCPTR)bark, 0) == OK && semTake(done, 3) == OK && barks[0] == 2);  /* in the last tick */
    barks[0] = 1;
    CHECK(wdStart(w, 2, (FUNCPTR)bark, 0) == OK && wdStart(w, 6, (FUNCPTR)bark, 0) == OK);
    taskDelay(4);
    CHECK(barks[0] == 1);                       /* started again */
    lock = intLock();
    taskDelay(4);
    CHECK(barks[0] == 1);
    intUnlock(lock);
    taskDelay(1);
    CHECK(barks[0] == 2 && wdDelete(w) == OK);
    while (semTake(done, NO_WAIT) == OK)
        ;
    then = tickGet();
    CHECK(wdStart(again, 5, (FUNCPTR)wake, 0) == OK && semTake(done, 20) == OK && tickGet() - then <= 6);  /* flushed: woken */
    wdStart(again, 2, (FUNCPTR)bark, 1);
    taskDelay(10);
    CHECK(barks[1] == 3);
    while (semTake(done, NO_WAIT) == OK)
        ;
    return 0;
}
static int seconds;
static void second(int unused) { (void)unused; seconds++; }
static int others(void)
{
    char text[4] = "abc", got[8];
    SEM_ID full = semBCreate(SEM_Q_FIFO, SEM_FULL);
    MSG_Q_ID q = msgQCreate(2, 4, MSG_Q_PRIORITY);
    UINT32 then;
    CHECK(semGive(full) == OK && semTake(full, NO_WAIT) == OK && semTake(full, NO_WAIT) == ERROR);     /* binary */
    CHECK(semGive(0) == ERROR && semTake(0, NO_WAIT) == ERROR);
    CHECK(msgQSend(q, text, 5, NO_WAIT, MSG_PRI_NORMAL) == ERROR && msgQNumMsgs(q) == 0);              /* too long */
    CHECK(msgQSend(q, text, 3, NO_WAIT, MSG_PRI_NORMAL) == OK && msgQSend(q, text + 1, 2, NO_WAIT, MSG_PRI_URGENT) == OK);
    CHECK(msgQSend(q, text, 1, NO_WAIT, MSG_PRI_NORMAL) == ERROR && errnoGet() == S_objLib_OBJ_UNAVAILABLE);
    CHECK(msgQNumMsgs(q) == 2 && msgQReceive(q, got, sizeof got, NO_WAIT) == 2 && got[0] == 'b');      /* urgent first */
    got[2] = 'x';
    CHECK(msgQReceive(q, got, 2, NO_WAIT) == 2 && got[0] == 'a' && got[1] == 'b' && got[2] == 'x');
    CHECK(sysClkRateSet(100001) == ERROR && sysClkRateSet(100000) == OK && sysClkRateGet() == 100000 && sysClkRateSet(100) == OK);
    sysOutLong(0x300, 0x03020180);                                                                     /* R0 = 030201h */
    CHECK(sysInLong(0x300) >> 8 == 0x030201);
    then = sysTimestamp();
    sysUsDelay(250);
    CHECK(sysTimestamp() - then >= 250 && sysTimestamp() - then <= 254 && sysTimestampFreq() == 1000000);
    then = sysTimestamp();
    CHECK(taskDelay(0) == OK && sysTimestamp() - then <= 10000);
    return 0;
}
static MSG_Q_ID queue;
static int order[4], n;
static void out(unsigned port, unsigned value) { sysOutByte(port, value); }
static void isr(int port)
{
    int word = 7;
    sysOutByte(port, 0x08);
    msgQSend(queue, (char *)&word, sizeof word, NO_WAIT, MSG_PRI_NORMAL);
    semGive(done);
}
static int task(int number) { order[n++] = number; return number == 3 ? 0 : OK; }
static int checks(void)
{
    int word = 0, lock;
    ULONG then;
    SEM_ID mutex = semMCreate(SEM_Q_PRIORITY | SEM_INVERSION_SAFE), count = semCCreate(SEM_Q_FIFO, 2);
    done = semBCreate(SEM_Q_FIFO, SEM_EMPTY);
    queue = msgQCreate(2, sizeof word, MSG_Q_FIFO);
    CHECK(sysClkRateGet() == 60 && sysClkRateSet(100) == OK && sysClkRateGet() == 100 && sysClkRateSet(0) == ERROR);
    then = tickGet();
    taskDelay(5);
    CHECK(tickGet() - then == 5);
    CHECK(semTake(mutex, WAIT_FOREVER) == OK && semTake(mutex, NO_WAIT) == OK && semGive(mutex) == OK);
    CHECK(semTake(count, NO_WAIT) == OK && semTake(count, NO_WAIT) == OK && semTake(count, NO_WAIT) == ERROR);
    CHECK(errnoGet() == S_objLib_OBJ_UNAVAILABLE);
    then = tickGet();
    CHECK(semTake(done, 10) == ERROR && errnoGet() == S_objLib_OBJ_TIMEOUT && tickGet() - then == 10);
    CHECK(msgQReceive(queue, (char *)&word, sizeof word, NO_WAIT) == ERROR);
    CHECK(intConnect(INUM_TO_IVEC(0x2A), isr, 0x300) == OK);
    CHECK(intConnect(INUM_TO_IVEC(0x2B), second, 0) == OK && intDisconnect(INUM_TO_IVEC(0x2B), 0, 0) == OK);
    CHECK(sysIntEnable(3) == OK && sysIntDisable(3) == OK);
    lock = intLock();
    move(out, 0x300);
    CHECK(semTake(done, 30) == ERROR);          /* interrupts are locked */
    intUnlock(lock);
    then = tickGet();
    CHECK(semTake(done, 1) == OK && tickGet() - then <= 1);
    CHECK(msgQNumMsgs(queue) == 1 && msgQReceive(queue, (char *)&word, sizeof word, NO_WAIT) == sizeof word && word == 7);
    move(out, 0x300);
    then = tickGet();
    CHECK(semTake(done, WAIT_FOREVER) == OK && tickGet() - then >= 9 && tickGet() - then <= 12);
    CHECK(watchdogs() == 0);
    CHECK(seconds == 0 && others() == 0);       /* the other vector has been called alone */
    CHECK(intDisconnect(INUM_TO_IVEC(0x2A), 0, 0) == OK);
    logMsg("%d and %s\\n", 5, (_Vx_usr_arg_t) "text", 0, 0, 0, 0);
    taskSpawn("b", 120, 0, 2000, (FUNCPTR)task, 2, 0, 0, 0, 0, 0, 0, 0, 0, 0);
    taskSpawn("a", 100, 0, 2000, (FUNCPTR)task, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0);
    CHECK(n == 0);
    return 0;
}
static int last(void) { return n == 2 && order[0] == 1 && order[1] == 2 ? 0 : 1000; }
int usrAppInit(void)
{
    taskSpawn("last", 200, 0, 2000, (FUNCPTR)last, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0);
    return checks();
}
"""
)

DOS = (
    """
#include <conio.h>
#include <dos.h>
#include <stdlib.h>
#include <time.h>
"""
    + CHECK
    + MOVE
    + """
static volatile int calls;
static void out(unsigned port, unsigned value) { outp(port, value); }
static void interrupt far isr(void) { calls++; outportb(0x300, 0x08); outportb(0x20, 0x20); }
static volatile int ticks, user_ticks;
static void interrupt (*old_tick)(void);
static void interrupt far tick(void) { ticks++; if (ticks % 2) old_tick(); else outportb(0x20, 0x20); }
static void interrupt far user_tick(void) { user_ticks++; }
static int timer(void)
{
    unsigned count, later;
    outportb(0x21, inportb(0x21) & ~1);
    setvect(0x1C, user_tick);
    delay(1000);
    CHECK(user_ticks == 18);
    old_tick = getvect(8);
    setvect(8, tick);
    outportb(0x43, 0x36); outportb(0x40, 0xA9); outportb(0x40, 0x04); /* 1193: 1 ms */
    delay(100);
    CHECK(ticks == 100 && user_ticks == 18 + 50);
    _disable();
    delay(50);
    CHECK(ticks == 100);
    _enable();
    CHECK(ticks == 101);                        /* one had waited */
    outportb(0x21, inportb(0x21) | 1);
    delay(50);
    CHECK(ticks == 101);                        /* masked */
    outportb(0x21, inportb(0x21) & ~1);
    outportb(0x43, 0x34); outportb(0x40, 0); outportb(0x40, 0);
    outportb(0x43, 0); count = inportb(0x40); count |= (unsigned)inportb(0x40) << 8;
    delay(10);
    outportb(0x43, 0); later = inportb(0x40); later |= (unsigned)inportb(0x40) << 8;
    CHECK(count - later >= 11930 && count - later <= 11950);
    setvect(8, old_tick);
    setvect(0x1C, 0);
    ticks = 0;
    delay(200);
    CHECK(ticks == 0);
    return 0;
}
static int checks(void)
{
    clock_t then = clock();
    time_t day = time(NULL);
    delay(250);
    CHECK(clock() - then == 250 && CLOCKS_PER_SEC == 1000);
    sleep(1);
    CHECK(time(NULL) - day == 1 && gmtime(&day)->tm_year == 90);
    CHECK(kbhit() && getch() == 'a' && kbhit() && getch() == 'b' && !kbhit());
    outportb(0x21, 0xFF);
    CHECK(inportb(0x21) == 0xFF);
    setvect(0x0D, isr);
    CHECK(getvect(0x0D) == isr);
    move(out, 0x300);
    delay(200);
    CHECK(calls == 0);                          /* masked */
    _disable();
    outportb(0x21, 0xDF);
    delay(10);
    CHECK(calls == 0);                          /* disabled */
    _enable();
    delay(1);
    CHECK(calls == 1);
    setvect(0x0D, 0);
    move(out, 0x300);
    delay(200);
    CHECK(calls == 1);
    outportb(0x300, 0x08);
    CHECK(inportb(0x2F0) == 0xFF && inport(0x2F0) == 0xFFFF);
    setvect(0x72, isr);
    outportb(0xA1, 0xFF);
    move(out, 0x300);
    delay(200);
    CHECK(calls == 1 && inportb(0xA1) == 0xFF);
    outportb(0xA1, 0xFD);
    delay(1);
    CHECK(calls == 1);                          /* IRQ 9 */
    outportb(0xA1, 0xFB);
    delay(1);
    CHECK(calls == 2);                          /* IRQ 10 */
    setvect(0x72, 0);
    outpw(0x300, 0x0080); outpw(0x302, 0x0302);
    CHECK(inpw(0x302) == 0x0302 && inportb(0x301) == 0);
    outportb(0x43, 0x14); outportb(0x40, 200);  /* the low byte alone, then the high one */
    for (int k = 0; k < 4; k++) { int v = inportb(0x40); CHECK(v >= 1 && v <= 200); }
    outportb(0x43, 0x24); outportb(0x40, 0x20);
    for (int k = 0; k < 4; k++) CHECK(inportb(0x40) >= 0x1F && inportb(0x40) <= 0x20);
    outportb(0x43, 0x34); outportb(0x40, 0); outportb(0x40, 0);
    CHECK(time(0) == 631152000 + clock() / 1000);
    then = biostime(0, 0L);
    delay(2000);
    CHECK(biostime(0, 0L) - then >= 36 && biostime(0, 0L) - then <= 37);
    cprintf("x = %d\\r\\n", 5);
    cputs("no end");
    return 0;
}
int main(void) { int wrong = checks(); exit(wrong ? wrong : timer()); }
"""
)

SKETCH = """
#include <SPI.h>
volatile int falls;
int result = 0;
#define CHECK(what) if (!(what) && !result) result = __LINE__
void fell() { falls++; }
void setup() {
  Serial.begin(9600);
  CHECK(Serial.parseInt() == -12 && Serial.read() == ',' && Serial.readStringUntil('\\n') == "mm" && !Serial.available());
  Serial.feed("3.5 x");
  CHECK(Serial.parseFloat() == 3.5f && Serial.available() == 2 && Serial.readString() == " x");
  Serial.print(255, HEX); Serial.print(' '); Serial.print(1.0 / 3, 3); Serial.print(F(" deg ")); Serial.println(-5);
  Serial.print("half a line");
  String s = String("a") + 1 + ',' + 2.5;
  CHECK(s == "a1,2.50" && s.indexOf(',') == 2 && s.substring(1, 2).toInt() == 1 && s.endsWith("0") && s.length() == 7);
  s.trim(); s.toUpperCase(); s.replace("A", "bb");
  CHECK(s.startsWith("bb1") && s.charAt(99) == 0 && String(-1, HEX) == "FFFFFFFF" && String(5, BIN) == "101");
  CHECK(min(2, 3L) == 2 && max(2, 3) == 3 && constrain(9, 0, 5) == 5 && map(5, 0, 10, 0, 100) == 50 && bitRead(4, 2) == 1);
  unsigned long then = micros();
  delay(3); delayMicroseconds(7);
  CHECK(micros() - then == 3008);
  CHECK(millis() == micros() / 1000);
  CHECK(SPI.transfer(0x55) == 0xFF && SPI.transfer16(1) == 0xFFFF);
  SPI.device = [](uint8_t sent) -> uint8_t { return sent + 1; };
  CHECK(SPI.transfer(4) == 5);
  pinMode(13, OUTPUT); digitalWrite(13, HIGH);
  CHECK(digitalRead(13) == HIGH && (PORTB & _BV(PB5)));
  PORTB &= ~_BV(PB5);
  CHECK(digitalRead(13) == LOW && digitalRead(7) == HIGH);
  attachInterrupt(digitalPinToInterrupt(2), fell, FALLING);
  begin();
  delay(300);
  CHECK(falls == 1 && ps_interrupt_line());
  ps_out8(0x300, 0x08);
  delay(1);
  noInterrupts();
  begin();
  delay(300);
  CHECK(falls == 1);
  interrupts();
  delay(1);
  CHECK(falls == 2);
  detachInterrupt(digitalPinToInterrupt(2));
  pulsestage::end(result);
}
void loop() {}
void begin() {
  const uint8_t cycles[] = {0, 0x08, 0, 0x80, 1, 100, 0, 0x81, 1, 50, 0, 0x87, 1, 30, 0, 0x44, 0, 0x30};
  for (unsigned k = 0; k < sizeof cycles; k += 2)
    ps_out8(0x300 + cycles[k], cycles[k + 1]);
}
"""

NUMBERS = """
#include <Arduino.h>
#define CHECK(what) if (!(what)) pulsestage::end(__LINE__ + 100)
void setup() {
  Serial.feed("x-12-34");
  const long first = Serial.parseInt(), second = Serial.parseInt();
  CHECK(first == -12 && second == -34);
  char bytes[8] = "zzzzzzz";
  Serial.feed("ab,cdefg");
  CHECK(Serial.readBytesUntil(',', bytes, 7) == 2 && bytes[1] == 'b' && bytes[2] == 'z');
  CHECK(Serial.readBytes(bytes, 3) == 3 && bytes[2] == 'e' && Serial.available() == 2);
  CHECK(Serial.peek() == 'f' && Serial.read() == 'f');
  CHECK(Serial.readBytes(bytes, 7) == 1 && Serial.read() == -1 && Serial.peek() == -1);
  CHECK(String(5ul, 1) == "5" && String(5ul, 0) == "5" && String(35ul, 36) == "Z" && String(7, 37) == "7");
  CHECK(String(1.005, -1) == "1" && String(2.5f, 3) == "2.500" && String((unsigned char)200) == "200" && String('c') == "c");
  String s("one two one");
  CHECK(s.lastIndexOf('o') == 8 && s.indexOf('o', 1) == 6 && s.indexOf("one", 1) == 8 && s.indexOf("six") == -1);
  CHECK(s.lastIndexOf('x') == -1);
  CHECK(s.substring(7, 4) == "two" && s.substring(8) == "one" && s.substring(11) == "");
  CHECK(s.substring(20) == "" && s.charAt(11) == 0);
  s.remove(3, 4);
  CHECK(s == "one one" && s.compareTo("one") > 0 && s.compareTo("two") < 0 && s < "two" && s > "one" && s != "one");
  s.replace("one", "oneone");
  CHECK(s == "oneone oneone" && s.length() == 13);
  s.remove(6);
  s.setCharAt(0, 'O');
  s.setCharAt(6, 'x');
  CHECK(s == "Oneone" && s.equalsIgnoreCase("oNEone") && !s.equals("oneone") && s.startsWith("One") && !s.startsWith("Oneonee"));
  CHECK(s.endsWith("one") && !s.endsWith("xOneone") && !s.endsWith("two") && !s.isEmpty() && String().isEmpty());
  s.toCharArray(bytes, 4);
  CHECK(!strcmp(bytes, "One") && String(" 12 x").toInt() == 12 && String("1.5e2").toFloat() == 150.0f);
  CHECK(String("-0.25").toDouble() == -0.25);
  String blank("  x y ");
  blank.trim();
  CHECK(blank == "x y" && blank.concat('z') && blank.concat("!") && blank == "x yz!");
  CHECK(lowByte(0x1234) == 0x34 && highByte(0x1234) == 0x12 && makeWord(1, 2) == 0x102 && bit(3) == 8 && sq(-3) == 9);
  uint8_t b = 0x81;
  bitSet(b, 1), bitClear(b, 0), bitToggle(b, 7), bitWrite(b, 6, 1);
  CHECK(b == 0x42 && constrain(-1, 0, 5) == 0 && constrain(3, 0, 5) == 3 && map(-5, -10, 10, 100, 0) == 75);
  CHECK(fabs(degrees(PI) - 180) < 1e-9 && fabs(radians(90) - HALF_PI) < 1e-9);
  randomSeed(7);
  const long one = random(1000), two = random(1000);
  randomSeed(7);
  CHECK(random(1000) == one && random(1000) == two && one != two && random(0) == 0 && random(5, 5) == 5);
  for (int k = 0; k < 200; k++) { const long r = random(3, 6); CHECK(r >= 3 && r < 6); }
  pulsestage::end(7);
}
void loop() {}
"""

STATICS = """
#include <pulsestage.h>
inline int &calls() { static int n; return n; }
template <typename T> struct Held { static T value; };
template <typename T> T Held<T>::value = 0;
PULSESTAGE_MAIN { return ++calls() * 10 + ++Held<int>::value; }
"""


@pytest.fixture(autouse=True)
def compilers(firmware):
    """Skips where there is none."""


def run(tmp_path, name, text, platform=None, flags=("-Wall", "-Wextra", "-Werror")):
    (tmp_path / name).write_text(text)
    host = NativeHost(tmp_path / name, Board(Stage("xy", visuals=False)), platform=platform, flags=flags)
    return host.run(timeout=20).code, [printed_text for _, printed_text in host.log]


AVR_TIMERS = (
    """
#include <avr/interrupt.h>
#include <avr/io.h>
#include <util/delay.h>
"""
    + CHECK
    + """
static volatile int compares, overflows;
ISR(TIMER1_COMPA_vect) { compares++; if (SREG & 0x80) compares += 100; }
ISR(TIMER0_OVF_vect) { overflows++; }
int main(void)
{
    TCCR1B = _BV(WGM12) | _BV(CS11);            /* CTC, 2 MHz */
    OCR1A = 1999;                               /* 1 ms */
    TIMSK1 |= _BV(OCIE1A);
    _delay_ms(5.5);
    CHECK(compares == 0 && TIFR1 & _BV(OCF1A));
    sei();
    CHECK(compares == 1);                       /* one had waited */
    _delay_ms(10);
    CHECK(compares == 11);
    CHECK(TCNT1 > 900 && TCNT1 < 1100);
    TIMSK1 = 0;
    TCNT1 = 0;
    TIFR1 = _BV(OCF1A);
    CHECK(!(TIFR1 & _BV(OCF1A)));
    _delay_us(1100);
    CHECK(TIFR1 & _BV(OCF1A) && compares == 11);
    TCCR0B = _BV(CS01) | _BV(CS00);             /* 250 kHz: 1.024 ms */
    TIMSK0 = _BV(TOIE0);
    _delay_ms(10.5);
    CHECK(overflows == 10);
    TCCR0B = 0;
    _delay_ms(5);
    CHECK(overflows == 10);
    TCCR2B = _BV(CS22);                         /* 64: of timer 2 only */
    _delay_us(400);
    CHECK(TCNT2 >= 99 && TCNT2 <= 101);
    return 0;
}
"""
)


def test_an_avr_has_timers(tmp_path):
    code, _ = run(tmp_path, "timers.c", AVR_TIMERS, "avr", ("-Wall", "-Wextra", "-Werror"))
    assert code == 0


def test_vxworks_waits_in_ticks_and_interrupts_give_semaphores(tmp_path):
    code, log = run(tmp_path, "vx.c", VXWORKS, "vxworks", ("-Wall", "-Wextra", "-Werror", "-Wno-cast-function-type"))
    assert (code, log) == (0, ["5 and text"])


def test_dos_has_time_keys_and_masked_interrupts(tmp_path):
    code, log = run(tmp_path, "dos.c", DOS, "dos", ("-Wall", "-Wextra", "-Werror", '-DPULSESTAGE_KEYS="ab"'))
    assert (code, log) == (0, ["x = 5", "no end"])


@pytest.mark.slow
def test_a_dos_program_may_be_c_plus_plus(tmp_path):
    text = """
    #include <dos.h>
    void interrupt (*old)(...);
    void interrupt isr(...) {}
    int main() { old = getvect(0x0D); setvect(0x0D, isr); setvect(0x0D, old); old(); return old ? 4 : 1; }
    """
    assert run(tmp_path, "plus.cpp", text, "dos")[0] == 4


@pytest.mark.slow
def test_a_sketch_has_serial_strings_spi_and_interrupts_by_edge(tmp_path):
    code, log = run(
        tmp_path, "a.ino", SKETCH, None, ("-Wall", "-Wextra", "-Werror", '-DPULSESTAGE_SERIAL_INPUT="x = -12,mm\\n"')
    )
    assert code == 0, SKETCH.splitlines()[code - 1]
    assert log == [
        "pins: no PinBus says how a chip is wired to them, so no chip sees them (docs/porting.md); STEP/DIR axes need "
        "--chips stepdir --pins x.step=D2,x.dir=D5",
        "FF 0.333 deg -5",
        "SPI.transfer: no device is at the SPI bus, or none is selected; it reads FFh. Set SPI.device to a function of yours, "
        "or name the chip's pin: PinBus(0x300).spi(10)",
        "half a line",
    ]


def test_a_minus_ends_a_number_and_begins_the_next(tmp_path):
    """G-code without blanks, "X-12Y-34" or "3-4": Serial.parseInt"""
    assert run(tmp_path, "numbers.cpp", NUMBERS, "arduino", ("-O0",))[0] == 7


@pytest.mark.slow
def test_each_run_of_c_plus_plus_begins_with_fresh_statics(tmp_path):
    (tmp_path / "statics.cpp").write_text(STATICS)
    library = build(tmp_path / "statics.cpp")
    for _ in range(3):
        assert NativeHost(library, Board(Stage("xy", visuals=False))).run(timeout=1).code == 11


@pytest.mark.slow
def test_an_error_of_a_sketch_names_its_line(tmp_path):
    (tmp_path / "a.ino").write_text("void setup() {}\n\nvoid loop() { nonsense(); }\n")
    with pytest.raises(Exception, match=r"a\.ino:3:\d+: error: .*nonsense"):
        build(tmp_path / "a.ino")


@pytest.mark.slow
def test_a_wait_without_an_event_ends_at_the_timeout(tmp_path):
    (tmp_path / "wait.c").write_text(
        "#include <semLib.h>\nSTATUS usrAppInit(void) { return semTake(semBCreate(0, SEM_EMPTY), WAIT_FOREVER); }\n"
    )
    host = NativeHost(tmp_path / "wait.c", Board(Stage("xy", visuals=False)), platform="vxworks")
    with pytest.raises(HostTimeout):
        host.run(timeout=1)


def test_headers_and_entries_are_in_the_wheel():
    data = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["package-data"]
    folder = get_include_folder() / "platforms"
    files = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.suffix in (".h", ".c", ".cpp")}
    assert len(files) > 20
    for file in files:
        assert any(fnmatch.fnmatch(file, pattern.replace("**/", "*")) for pattern in data["stage.board.platforms"]), (
            file
        )
