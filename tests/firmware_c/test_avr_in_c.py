"""A program in C that includes headers of an AVR is compiled as C, and its registers behave as those of C++ do."""

from __future__ import annotations

import random
import re
import warnings
from pathlib import Path

import pytest

from stage import Stage
from stage.board import Board, CompileError, CompilerWarning, NativeHost, build, get_include_folder

AVR = get_include_folder() / "platforms" / "avr"
AVR_LIBC = Path("/usr/lib/avr/include/avr")
STRICT = ("-Wall", "-Wextra", "-Werror")
MEGA = ("-D__AVR_ATmega2560__",)
LISTS = re.findall(
    r"#define PULSESTAGE_(STATES|EVENTS|WORDS)(_OF_ATMEGA2560)?\(X\)((?:.*\\\n)*.*)",
    (AVR / "avr/addresses_.h").read_text(),
)
REGISTERS = [
    (name, kind, int(address, 16), bool(of_mega))
    for kind, of_mega, rows in LISTS
    for name, address in re.findall(r"X\((\w+), (0x\w+)\)", rows)
]
CHECK = "#define CHECK(what) do { if (!(what)) return __LINE__; } while (0)\n"
ONLY_C = """\
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/pgmspace.h>
#include <stdlib.h>
#include <string.h>
#include <util/delay.h>

struct pair { uint8_t template, class; volatile uint8_t *this; };
static const __flash uint8_t table[] PROGMEM = {[2] = 7, [0] = 5};
static const struct pair pairs[] = {{.this = &PORTB, .class = 1}, {.class = 2, .this = &PORTC}};
static volatile uint8_t new;
int private;
int private;                                     /* a tentative definition */
ISR(TIMER1_COMPA_vect) { new++; }
static uint8_t add(a, b) uint8_t a; int b; { return a + b; }
static int sum(int n, const uint8_t (*bytes)[n])
{
    int total = 0;
    for (int k = 0; k < n; k++)
        total += (*bytes)[k];
    return total;
}
static void set(struct pair p) { *p.this |= p.class; }
int main(void)
{
    uint8_t *room = malloc(sizeof 'x');          /* an int in C */
    int n = 3;
    uint8_t typename[n];
    enum { delete = 4 } operator = 2;
    memcpy(typename, table, n);
    set(pairs[0]);
    set((struct pair){.class = delete, .this = &PORTC});
    OCR1A = 99, TCCR1B = 1 << WGM12 | 1 << CS10, TIMSK1 = 1 << OCIE1A;
    sei();
    _delay_us(30);
    free(room);
    return 100 * (sum(n, &typename) == 12 && sizeof 'x' == sizeof(int)) + PORTB + PORTC * 10 + add(new, operator) - 2;
}
"""


def make_board(chips: str = "stepdir") -> Board:
    return Board(Stage("xy", chips=chips, visuals=False))


def run(folder: Path, source: str | dict[str, str], flags=(), name="main.c", cost=0.0, chips="stepdir"):
    """Run a program of one source or several, and return its code, its log, and the clock at its end."""
    sources = {name: source} if isinstance(source, str) else source
    for file, text in sources.items():
        (folder / file).write_text(text)
    files = [folder / file for file in sources]
    with NativeHost(files, make_board(chips), platform="avr", flags=flags, cost=cost, patience=10) as host:
        result = host.run(timeout=20)
        return result.code, [text for _, text in host.log if not text.startswith("pins:")], host


@pytest.mark.parametrize("standard", ["gnu99", "gnu11", "gnu17"])
@pytest.mark.parametrize("level", ["-O0", "-O3"])
def test_what_only_c_takes_compiles_in_a_program_with_registers(standard, level, tmp_path):
    code, _, _ = run(tmp_path, ONLY_C, (f"-std={standard}", level))
    assert code == 100 + 1 + 40 + 4  # four matches in 30 us


def test_headers_are_c89_for_programs_that_are(tmp_path):
    """avr-gcc -std=c89; and an avr/io.h without sbi, which many programs define."""
    source = """#include <avr/eeprom.h>
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/pgmspace.h>
#include <util/atomic.h>
#include <util/delay.h>
#define sbi(port, bit) ((port) |= (1 << (bit)))
ISR(TIMER1_COMPA_vect) { PORTB ^= 1; }
int main(void) { int k; sbi(PORTB, 3); for (k = 0; k < 3; k++) PORTB ^= 2; eeprom_write_byte((uint8_t *)4, 7);
                 return PORTB + eeprom_read_byte((uint8_t *)4); }
"""
    with warnings.catch_warnings():
        warnings.simplefilter("error", CompilerWarning)
        assert run(tmp_path, source, ("-std=c89", "-Wall", "-Werror"))[0] == 8 + 2 + 7


LVALUES = (
    CHECK
    + """
#include <avr/io.h>
struct bits { uint8_t b0 : 1, b1 : 1, b2 : 1, rest : 5; };
#define BITS(port) (*(volatile struct bits *)&(port))
#define DDR(port) (*(&(port) - 1))
#define PIN(port) (*(&(port) - 2))
static volatile uint8_t *const ports[] = {&PORTB, &PORTC, &PORTD};
static void set(volatile uint8_t *port, uint8_t bits) { *port |= bits; }
static uint8_t next(void) { static uint8_t n; return ++n; }
union word { volatile uint16_t whole; volatile uint8_t bytes[2]; };
int main(void)
{
    volatile uint8_t *p = &PORTB;
    volatile uint16_t *compare = &OCR1A;
    *p |= 4;
    CHECK(PORTB == 4 && *p == 4);
    *p++ = 8;                                    /* on to the next register, which is PINC */
    CHECK(p == &PINC && PORTB == 8);
    for (int k = 0; k < 3; k++)
        *ports[k] = 1 << k, DDR(*ports[k]) = 0xFF;
    CHECK(PORTB == 1 && PORTC == 2 && PORTD == 4 && DDRB == 0xFF && PIN(PORTC) == 2);
    set(&PORTC, 0x40), set(ports[1], 0x80);
    CHECK(PORTC == 0xC2);
    BITS(PORTB).b2 = 1, BITS(PORTB).b0 = 0;
    CHECK(PORTB == 4 && BITS(PORTB).b2 == 1 && BITS(PORTB).rest == 0);
    BITS(PORTB).rest = 3;
    CHECK(PORTB == 0x1C);
    PORTB = PORTC = next();
    CHECK(PORTB == 1 && PORTC == 1);
    CHECK((PORTB = 7) == 7 && PORTB++ == 7 && --PORTB == 7 && (PORTB <<= 1, PORTB) == 14 && (PORTB >>= 2) == 3);
    PORTB = ~PORTB;
    CHECK(PORTB == 0xFC);
    PINB = 0x0C, PINB = 0x04;                    /* a toggle each */
    CHECK(PORTB == 0xF4);
#ifndef __clang__                                /* which reads the other bits and writes them again */
    BITS(PINB).b1 = 1;                           /* as `sbi` */
    CHECK(PORTB == 0xF6);
#endif
    PORTB = 0xF6;
    *compare = 0x1234, *compare += 1;
    CHECK(OCR1A == 0x1235 && ((union word *)&OCR1A)->whole == 0x1235 && ((union word *)&OCR1A)->bytes[0] == 0x35);
    OCR1AH = 0x56, OCR1AL = 0x78;
    CHECK(OCR1A == 0x5678);
    CHECK(*(volatile uint16_t *)&DDRB == 0xF6FF); /* two registers at once */
    *(volatile uint32_t *)&DDRB = 0x0F010203;    /* DDRB, PORTB, PINC, DDRC */
    CHECK(DDRB == 3 && PORTB == 2 && PORTC == 0 && DDRC == 0x0F);
    *(uint8_t *)&PORTD = 9;                      /* the pointer is not volatile */
    CHECK(PORTD == 9);
    CHECK(_SFR_IO_ADDR(PORTB) == 5 && _SFR_MEM_ADDR(OCR1A) == 0x88 && &_SFR_IO8(5) == &PORTB && &_SFR_MEM8(0x25) == p - 1);
    UBRR0 = 0x0102, UCSR0C = 6;
    CHECK(UBRR0H == 1 && UBRR0L == 2 && UBRR == UBRR0 && UCSR0C == 6 && MCUSR == 1 << PORF);
    return 0;
}
"""
)


@pytest.mark.parametrize("level", ["-O0", "-O1", "-O2", "-O3", "-Os"])
def test_registers_are_lvalues(level, tmp_path):
    code, _, _ = run(tmp_path, LVALUES, (*STRICT, level))
    assert code == 0, LVALUES.splitlines()[code - 1]


@pytest.mark.parametrize(("header", "flags"), [("iom328p.h", ()), ("iomxx0_1.h", MEGA)])
def test_registers_have_the_addresses_of_the_chip(header, flags, tmp_path):
    if not (AVR_LIBC / header).is_file():
        pytest.skip(f"there is no {AVR_LIBC / header} (Debian: avr-libc)")
    places = dict(re.findall(r"#\s*define\s+(\w+)\s+_SFR_(\w+\s*\(0x\w+\))", (AVR_LIBC / header).read_text()))
    names = [name for name, *_, of_mega in REGISTERS if flags or not of_mega]
    names += [f"{name}{n}{end}" for n in range(4 if flags else 1) for name, end in (("UBRR", ""), ("UCSR", "C"))]
    checks = [f"CHECK(&{name} == &_SFR_{places[name]});\n" for name in names if name in places]
    assert len(checks) > (150 if flags else 70)
    text = CHECK + "#include <avr/io.h>\nint main(void)\n{\n" + "".join(checks) + "return 0;\n}\n"
    code, _, _ = run(tmp_path, text, (*flags, *STRICT))
    assert code == 0, text.splitlines()[code - 1]


def make_register_program(names: list[str], rng: random.Random, has_board: bool) -> str:
    """Make a program that accesses registers at random and logs what it reads."""
    lines = []
    for _ in range(150):
        name, value = rng.choice(names), rng.randrange(256)
        lines.append(
            rng.choice(
                (
                    f"{name} = {value};",
                    f"{name} {rng.choice(('|=', '&=', '^=', '+=', '-='))} {value};",
                    f"{name} <<= {rng.randrange(4)};",
                    f"{name} = {rng.choice(names)};",
                    f'ps_logf("{name} %d", (int)({name}));',
                    f"_delay_us({rng.randrange(50)});",
                    f"if ({name} & {1 << rng.randrange(8)}) n++;",
                    rng.choice(("sei();", "cli();")),
                    f"ps_out8(0x300, {value});" if has_board else "n++;",
                )
            )
        )
    return (
        "#include <avr/interrupt.h>\n#include <avr/io.h>\n#include <pulsestage.h>\n#include <util/delay.h>\nstatic int n;\n"
        "ISR(TIMER0_COMPA_vect) { PORTB ^= 1; }\nISR(TIMER1_OVF_vect) { OCR1A += 7; }\nISR(TIMER2_COMPB_vect) { n++; TCNT2 = 3; }\n"
        "int main(void)\n{\n"
        + "\n".join(lines)
        + '\nps_logf("%d at %llu", n, (unsigned long long)ps_nanoseconds());\nreturn 0;\n}\n'
    )


@pytest.mark.parametrize("seed", range(6))
def test_registers_do_in_c_what_they_do_in_cpp(seed, tmp_path):
    rng = random.Random(seed)
    flags = MEGA if seed % 2 else ()
    names = [
        name
        for name, kind, _, of_mega in REGISTERS
        if (flags or not of_mega) and not (kind == "EVENTS" and name.startswith(("UDR", "EE")))
    ]
    text = make_register_program(names, rng, seed % 3 == 0)
    results = []
    for name in ("main.c", "main.cpp"):
        code, log, host = run(
            tmp_path, text, (*flags, f"-O{seed % 4}"), name=name, chips="PCL240K" if seed % 3 == 0 else "stepdir"
        )
        results.append((code, log, host.board.trace.text(), host.board.stage.time))
    assert len(results[0][1]) > 5
    assert results[0] == results[1], f"seed {seed}"


def test_each_write_counts_and_each_read(tmp_path):
    """Equal values sent twice are two bytes; a read of UDR0 takes one byte."""
    text = CHECK + """
#include <avr/io.h>
static uint8_t letter(void) { return 'c'; }
int main(void)
{
    UCSR0B = 1 << TXEN0 | 1 << RXEN0;
    UDR0 = 'a'; UDR0 = 'a';
    while (!(UCSR0A & (1 << UDRE0))) ;
    UDR0 = letter();
    CHECK(UCSR0A & (1 << RXC0));
    UDR0 = UDR0;                                 /* an echo */
    const char second = UDR0;
    CHECK(second == 'y' && (UDR0, UDR0) == 'w');
    UDR0 = '\\n';
    TCCR0B = 1 << CS00, OCR0A = 10;
    while (!(TIFR0 & (1 << OCF0A))) ;
    TCCR0B = 0;
    CHECK(TIFR0 & (1 << OCF0A));
    TIFR0 = 1 << OCF0A;
    CHECK(!(TIFR0 & (1 << OCF0A)));
    TCNT0 = 10, TCNT0 = 5;
    CHECK(TCNT0 == 5);
    UDR0 = 'z';                                  /* just before the end */
    return 0;
}
"""  # fmt: skip
    code, log, _ = run(tmp_path, text, (*STRICT, '-DPULSESTAGE_SERIAL_INPUT="xyvw"'))
    assert code == 0, text.splitlines()[code - 1]
    assert log == ["aacx", "z"]


WIRING = """\
#include <avr/io.h>
#include <pinbus.h>
#include <util/delay.h>
static PinBus chip = PinBus(0x300).data_port('A').address(PIN_OF('C', 0)).wr(PIN_OF('G', 0)).rd(PIN_OF('G', 1));
extern "C" int read_port(void) { return PORTG; }
extern "C" void make_cycle(int value) { ps_out8(0x304, value); }
extern "C" void turn_on(void) { PORTB |= 0x10; }
extern "C" int call(void (*function)(void)) { function(); return pulsestage::pins().port[1]; }
"""


def test_no_request_and_no_access_of_cpp_overtakes_a_write(tmp_path):
    text = CHECK + """
#include <avr/io.h>
#include <pulsestage.h>
#include <util/delay.h>
int read_port(void);
void make_cycle(int value), turn_on(void);
int call(void (*function)(void));
static void strobe(void) { PORTG &= ~1; PORTG |= 1; }
static void set(void) { PORTB = 0x21; }
int main(void)
{
    PORTG = 3, DDRG = 3, DDRA = 0xFF, DDRC = 1;
    PORTA = 0x11, PORTG &= ~1, PORTG |= 1;
    ps_out8(0x304, 0x12);
    PORTA = 0x13, strobe();
    make_cycle(0x14);
    PORTA = 0x15, PORTG = 2, PORTG = 3;
    make_cycle(0x16);
    PORTG = 2;
    CHECK(read_port() == 2);
    PORTG = 3;
    _delay_us(10);
    PORTB = 1;
    turn_on();
    CHECK(PORTB == 0x11 && call(set) == 0x21);
    PORTG = 2, PORTA = 0x17, PORTG = 3;
    return 0;
}
"""  # fmt: skip
    code, _, host = run(tmp_path, {"main.c": text, "wiring.cpp": WIRING}, STRICT, chips="PCL240K")
    assert code == 0, text.splitlines()[code - 1]
    values = [cycle.value for cycle in host.board.trace if cycle.direction == "W"]
    assert values == [0x11, 0x12, 0x13, 0x14, 0x15, 0x16, 0x15, 0x17]


INTERRUPTS = (
    CHECK
    + """
#define F_CPU 8000000UL
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>
#include <util/atomic.h>
#include <util/delay.h>
static volatile uint16_t ticks;
static uint8_t seen;                             /* not volatile: `sei` and `cli` are barriers */
ISR(TIMER1_COMPA_vect) { ticks++; seen = 1; PORTB = ticks; }
EMPTY_INTERRUPT(TIMER1_OVF_vect)
ISR(TIMER0_OVF_vect, ISR_NOBLOCK) { sei(); PORTC++; }
ISR(ADC_vect) {}
int main(void)
{
    OCR1A = 799, TCCR1B = 1 << WGM12 | 1 << CS10, TIMSK1 = 1 << OCIE1A; /* each 100 us of 8 MHz */
    _delay_us(250);
    CHECK(ticks == 0 && PORTB == 0 && TIFR1 & (1 << OCF1A));
    sei();
    CHECK(seen && ticks == 1 && PORTB == 1);
    _delay_us(200);
    CHECK(ticks == 3 && PORTB == 3);
    uint8_t before = SREG;
    cli();
    loop_until_bit_is_set(TIFR1, OCF1A);
    CHECK(ticks == 3);
    SREG = before;
    CHECK(ticks == 4 && PORTB == 4);
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        loop_until_bit_is_set(TIFR1, OCF1A);
        CHECK(ticks == 4 && !(SREG & (1 << SREG_I)));
    }
    CHECK(ticks == 5 && SREG & (1 << SREG_I));
    cli();
    ATOMIC_BLOCK(ATOMIC_FORCEON) {
        ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { loop_until_bit_is_set(TIFR1, OCF1A); }
        CHECK(!(SREG & 0x80) && ticks == 5);
    }
    CHECK(SREG & 0x80 && ticks == 6);
    while (ticks < 9)
        sleep_mode();
    CHECK(PORTB == 9);
    while (ticks < 12)                           /* a variable that only an interrupt routine changes */
        ;
    CHECK(PORTB == 12);
    seen = 0;
    for (;;) {
        cli();
        if (seen)
            break;
        sei();
    }
    CHECK(ticks == 13);
    return 0;
}
"""
)


@pytest.mark.parametrize("level", ["-O0", "-O2", "-O3"])
def test_interrupts_come_as_sreg_lets_them(level, tmp_path):
    code, _, _ = run(tmp_path, INTERRUPTS, (level, "-Wall", "-Wextra"))
    assert code == 0, INTERRUPTS.splitlines()[code - 1]


@pytest.mark.parametrize(
    ("text", "flags"),
    [
        ("#define F_CPU 8000000UL\n#include <avr/io.h>\n#include <util/delay.h>\n", ()),
        ("#include <avr/io.h>\n#undef F_CPU\n#define F_CPU 8000000UL\n#include <util/delay.h>\n", ()),
        ("#include <avr/io.h>\n#include <util/delay.h>\n", ("-DF_CPU=8000000UL",)),
    ],
)
def test_the_clock_of_the_timers_is_that_of_the_source(text, flags, tmp_path):
    text += "int main(void) { TCCR1B = 1 << CS11; _delay_us(1000); return TCNT1 / 10; }\n"
    assert run(tmp_path, text, flags)[0] == 100


def test_atomic_variables_of_c11(tmp_path):
    text = CHECK + """
#include <avr/io.h>
#include <stdatomic.h>
static atomic_int a = 1;
static _Atomic uint8_t b;
int main(void)
{
    CHECK(atomic_fetch_add(&a, 4) == 1 && atomic_exchange(&b, 7) == 0 && atomic_load(&b) == 7);
    int expected = 5;
    CHECK(atomic_compare_exchange_strong(&a, &expected, 9) && a == 9);
    a |= 6;
    b ^= 1;
    atomic_thread_fence(memory_order_seq_cst);
    CHECK(a == 15 && b == 6);
    return 0;
}
"""  # fmt: skip
    assert run(tmp_path, text, STRICT)[0] == 0


def test_a_source_without_registers_writes_a_port_by_its_pointer(tmp_path):
    sources = {
        "main.c": "#include <avr/io.h>\nvoid set(volatile uint8_t *port);\nint main(void) { set(&PORTB); return PORTB; }\n",
        "set.c": "#include <stdint.h>\nvoid set(volatile uint8_t *port) { *port = 1; *port |= 4; int new = 8; *port |= new; }\n",
    }
    assert run(tmp_path, sources)[0] == 13


def test_computing_takes_time_with_a_cost(tmp_path):
    text = "#include <avr/io.h>\nint main(void) { for (volatile int k = 0; k < 1000; k++) PORTB ^= 1; return 0; }\n"
    times = [run(tmp_path, text, cost=cost)[2].board.stage.time for cost in (100e-9, 200e-9)]
    assert times[0] > 1000 * 100e-9
    assert times[1] == pytest.approx(2 * times[0], rel=0.01)


def test_a_message_names_the_source_and_its_line(tmp_path):
    (tmp_path / "main.c").write_text("#include <avr/io.h>\nint main(void)\n{\n    PORTB = absent;\n    for (;;) ;\n}\n")
    with pytest.raises(
        CompileError, match=rf"^{tmp_path}/main\.c does not(?s:.*){tmp_path}/main\.c:4:\d+: error: .*absent"
    ):
        build(tmp_path / "main.c", platform="avr")


def test_a_header_that_is_missing_is_the_only_one_in_the_message(tmp_path):
    (tmp_path / "main.c").write_text("#include <avr/io.h>\n#include <absent.h>\nint main(void) { return 0; }\n")
    with pytest.raises(CompileError, match=r"main\.c:2:\d+: fatal error: .*absent\.h") as error:
        build(tmp_path / "main.c", platform="avr")
    assert "is C++ here" not in str(error.value)


def test_a_sketch_and_its_source_in_c_share_the_registers(tmp_path):
    folder = tmp_path / "both"
    folder.mkdir()
    (folder / "both.ino").write_text("""\
extern "C" void c_set(volatile unsigned char *port);
extern "C" int c_get(void);
void setup() {
  pinMode(13, OUTPUT);
  c_set(portOutputRegister(digitalPinToPort(8)));
  Serial.println(digitalRead(13));
  PORTC = 0x15;
  Serial.println(c_get());
  pulsestage::end(0);
}
void loop() {}
""")
    (folder / "led.c").write_text("""\
#include <avr/io.h>
static int class;
void c_set(volatile unsigned char *port) { PORTB |= 1 << 5; *port |= 1; class = 1; }
int c_get(void) { return PORTC + 100 * PORTB + class; }
""")
    with NativeHost(folder / "both.ino", make_board()) as host:
        host.run(timeout=1)
        assert [text for _, text in host.log][-2:] == ["1", str(0x15 + 100 * 0x21 + 1)]


SIMPLE = "#include <avr/io.h>\nint main(void) { PORTB |= 5; while (!(UCSR0A & (1 << UDRE0))) ; return PORTB; }\n"


def test_a_compiler_that_reports_no_accesses_compiles_c_as_cpp_and_says_so(tmp_path, monkeypatch):
    compiler = tmp_path / "old"
    compiler.write_text('#!/bin/sh\ncase "$*" in *tsan-distinguish*) exit 1; esac\nexec cc "$@"\n')
    compiler.chmod(0o755)
    monkeypatch.setenv("CC", str(compiler))
    with pytest.warns(
        CompilerWarning, match=rf"main\.c: compiled as C\+\+, because {compiler} does not report .* gcc 11"
    ):
        assert run(tmp_path, SIMPLE)[0] == 5


def test_a_sanitizer_that_excludes_reports_is_named(tmp_path):
    (tmp_path / "main.c").write_text(SIMPLE)
    with pytest.warns(
        CompilerWarning, match=r"main\.c: compiled as C\+\+, because .* with -fsanitize=address does not report"
    ):
        library = build(tmp_path / "main.c", platform="avr", flags=["-fsanitize=address"])
    with NativeHost(library, make_board()) as host:
        assert host.run().code == 5


def test_a_source_in_c_that_wires_pins_is_compiled_as_cpp(tmp_path):
    text = "#include <avr/io.h>\nstatic PinBus chip = PinBus(0x300).data_port('A');\nint main(void) { PORTB = 3; return PORTB; }\n"
    assert run(tmp_path, text)[0] == 3
