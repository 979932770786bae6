"""Registers and bits of an AVR have their names and places in programs that are compiled for this machine."""

import re
from pathlib import Path

import pytest

from stage import Stage
from stage.board import Board, NativeHost

AVR_LIBC = Path("/usr/lib/avr/include/avr")
NAMES = """\
#include <avr/eeprom.h>
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/pgmspace.h>
#define CHECK(what) do { if (!(what)) return __LINE__; } while (0)
static const __flash unsigned char table[] = {1, 2, 3};
volatile unsigned char *const led = &PORTB;
struct settings { unsigned char pin; volatile unsigned char *port; };
static struct settings leds[] = { { .pin = PB1, .port = &PORTB }, { .pin = PB2, .port = &PORTB } };
unsigned char EEMEM kept = 5;
ISR(PCINT0_vect) {}
ISR(ADC_vect) {}
int main(void)
{
    unsigned char *where = (unsigned char *)7;                 /* an address of the EEPROM */
    CHECK(COM1A1 == 7 && COM1B0 == 4 && OCIE0B == 2 && PCIE0 == 0 && PCINT4 == 4 && EEMWE == 2 && EEWE == 1 && FOC1A == 7);
    CHECK(table[2] == 3);
    PCICR |= _BV(PCIE0);
    PCMSK0 |= _BV(PCINT1);
    CHECK(PCICR == 1 && PCMSK0 == 2 && MCUSR == _BV(PORF));
    DDRB = 0xFF;
    *led |= _BV(PB3);
    CHECK(PORTB == 8 && PINB == 8);
    *leds[0].port ^= _BV(leds[0].pin);
    CHECK(PORTB == 10);
    PORTB = 1;
    CHECK(*led == 1);
    while (EECR & _BV(EEPE)) ;
    EEAR = 7; EEDR = 42; EECR |= _BV(EEMWE); EECR |= _BV(EEWE);
    CHECK(EECR & _BV(EEPE));
    while (EECR & _BV(EEPE)) ;
    EEDR = 0; EECR |= _BV(EERE);
    CHECK(EEDR == 42 && eeprom_read_byte(where) == 42 && eeprom_read_byte(&kept) == 5);
    eeprom_update_word((uint16_t *)8, 0x1234);
    CHECK(eeprom_read_byte((uint8_t *)9) == 0x12);
    EEDR = 1; EECR |= _BV(EEWE);                               /* without EEMWE */
    EECR |= _BV(EERE);
    CHECK(EEDR == 42);
    OCR1AH = 0x12; OCR1AL = 0x34;
    CHECK(OCR1A == 0x1234 && OCR1AL == 0x34 && OCR1AH == 0x12);
    return 0;
}
"""
EEPROM_SKETCH = """\
#include <EEPROM.h>
void setup() {
  Serial.println(EEPROM.read(3));
  EEPROM.write(3, EEPROM.read(3) + 2);
  pulsestage::end(0);
}
void loop() {}
"""


def make_board() -> Board:
    return Board(Stage("xyz", chips="stepdir", visuals=False))


def test_a_program_in_c_uses_the_registers_and_bits_by_their_names(tmp_path):
    (tmp_path / "names.c").write_text(NAMES)
    with NativeHost(tmp_path / "names.c", make_board(), platform="avr") as host:
        code = host.run().code
    assert code == 0, NAMES.splitlines()[code - 1]


@pytest.mark.parametrize(("header", "flags"), [("iom328p.h", ()), ("iomxx0_1.h", ("-D__AVR_ATmega2560__",))])
def test_every_bit_of_a_register_has_its_place(header, flags, tmp_path):
    if not (AVR_LIBC / header).is_file():
        pytest.skip(f"there is no {AVR_LIBC / header} (Debian: avr-libc)")
    register, checks = "", []
    for line in (AVR_LIBC / header).read_text().splitlines():
        if match := re.match(r"#\s*define\s+(\w+)\s+_SFR_(?:IO|MEM)(?:8|16)\b", line):
            register = match[1]
        elif register and (match := re.match(r"#\s*define\s+([A-Z]\w+)\s+([0-7])\s*(?:/\*.*)?$", line)):
            is_data = re.fullmatch(
                rf"{register}_?\d+|(?:ADCH|ADCL|OCR2|UBRR0|TWBR|TWD|EEAR|EEDR|OCDR|CAL)_?\d+", match[1]
            )
            if is_data and not match[1].startswith(("PORT", "PIN", "DD")):
                continue  # bits of numbers, which nobody names
            if match[1].endswith("_num") or match[1] in ("IDRD", "TWAM6", *(f"TWAM{k}" for k in range(6))):
                continue  # numbers of vectors; bits that the headers number in different ways
            checks.append(f'static_assert({match[1]} == {match[2]}, "{match[1]}");')
    assert len(checks) > 200
    (tmp_path / "bits.cpp").write_text("#include <avr/io.h>\n" + "\n".join(checks) + "\nint main(void) { return 0; }\n")
    with NativeHost(tmp_path / "bits.cpp", make_board(), platform="avr", flags=flags) as host:
        assert host.run().code == 0


def test_a_file_keeps_the_eeprom_from_run_to_run(tmp_path):
    (tmp_path / "memory.ino").write_text(EEPROM_SKETCH)
    file = tmp_path / "settings.eep"
    flags = (f'-DPULSESTAGE_EEPROM="{file}"',)
    logs = []
    for _ in range(3):
        with NativeHost(tmp_path / "memory.ino", make_board(), flags=flags) as host:
            host.run()
            logs.append(host.log[-1][1])
    assert logs == ["255", "1", "3"]
    assert file.read_bytes()[:5] == b"\xff\xff\xff\x05\xff"
    assert file.stat().st_size == 1024
