"""What each chip's listener says of bus cycles: sentences as a reader of a trace wants them, and what holds for all of them."""

import random
import re

import pytest
from support.examples import FIXED

from stage.chips import CHIPS, HCTL1100, MCX302, MCX304, MCX312, MCX514, PCL240K, PCL240MK, PCL240MS
from stage.chips.cycle_descriptions import MAX_LINE_LENGTH

NOVA = (MCX514, MCX304, MCX302, MCX312)
PCL = (PCL240K, PCL240MK, PCL240MS)
W, R = True, False
SEEDS = range(2 if FIXED else 8)


def happen(chip, cycle):
    """Let a bus cycle (write or read, address, value written) happen; the cycle with the value that was on the bus."""
    write, address, value = cycle
    if write:
        chip.write(address, value)
        return cycle
    return (*cycle[:2], chip.read(address))


def says(listener, cycle):
    """Return the description of a bus cycle by a listener."""
    write, address, value = cycle
    return listener.write(address, value) if write else listener.read(address, value)


def received(chip, listener, cycle):
    """Let the cycle happen; what the listener says of it."""
    return says(listener, happen(chip, cycle))


def after(chip, *cycles):
    """Return the description of the last of several cycles."""
    listener = chip.make_describer()
    return [received(chip, listener, cycle) for cycle in cycles][-1]


# --- PCL-240 ---


@pytest.mark.parametrize(
    ("cycle", "sentence"),
    [
        ((W, 0, 0x85), "select R5: deceleration rate"),
        ((W, 0, 0x11), "start, constant FH1"),
        ((W, 0, 0x37), "start, ramp to FH2, /INT at stop"),
        ((W, 0, 0x08), "reset command"),
        ((W, 0, 0x4C), "control mode: minus, preset"),
        ((W, 0, 0xC1), "output mode: independent"),
        ((W, 3, 0x12), "R0 bits 23..16 = 12h"),
        ((W, 1, 0x12), "R0 bits 7..0 = 12h: R0 = 12h (18)"),
        ((R, 0, 0), "status: not operating, neither ramping up nor down, R0 = 0"),
        ((R, 2, 0), "R0 bits 15..8 = 00h"),
    ],
)
def test_a_cycle_of_the_pcl240_says_what_it_means(cycle, sentence):
    assert after(PCL240K(), cycle) == sentence


def test_a_status_byte_is_described_field_by_field():
    listener = PCL240K().make_describer()
    assert listener.read(0, 0xD8) == "status: operating, R0 < R6, R0 = 0"
    assert listener.read(0, 0x60) == "status: /INT pending, operating, neither ramping up nor down"


@pytest.mark.parametrize("order", [(3, 2, 1), (1, 2, 3)])
def test_the_value_of_a_register_is_described_with_the_last_of_its_bytes(order):
    chip = PCL240K()
    listener = chip.make_describer()
    message = [received(chip, listener, (W, a, 0x123400 >> 8 * (a - 1) & 0xFF)) for a in order]
    assert message[-1].endswith(": R0 = 123400h (1192960)")
    assert message[1] == "R0 bits 15..8 = 34h"


def test_a_byte_above_the_width_of_a_register_is_described_so():
    assert after(PCL240K(), (W, 0, 0x81), (W, 3, 1)) == "R1 bits 23..16 = 01h: R1 has 13 bits"


def test_in_collective_mode_the_upper_bytes_wait():
    chip = PCL240MS()
    listener = chip.make_describer()
    cycles = [(W, 0, 0xA0), (W, 3, 0x01), (W, 2, 0x02), (W, 1, 0x03)]
    assert [received(chip, listener, c) for c in cycles] == [
        "select R0, collective: down counter",
        "R0 bits 23..16 = 01h: waits for bits 7..0",
        "R0 bits 15..8 = 02h: waits for bits 7..0",
        "R0 bits 7..0 = 03h: R0 = 10203h (66051)",
    ]
    assert [received(chip, listener, (R, a, 0)) for a in (3, 2, 1)] == [
        "R0 bits 23..16 = 01h, latched",
        "R0 bits 15..8 = 02h",
        "R0 bits 7..0 = 03h: R0 = 10203h (66051), as latched",
    ]


def test_in_extension_mode_a_read_describes_the_selected_register():
    chip = PCL240MS()
    assert after(chip, (W, 0, 0x82), (W, 1, 0x3C), (R, 1, 0)) == "R0 bits 7..0 = 00h"
    assert after(chip, (W, 0, 0xC8), (R, 1, 0)) == "R2 bits 7..0 = 3Ch"


def test_the_fields_of_a_register_are_described():
    message = after(PCL240MS(), (W, 0, 0x94), (W, 3, 0), (W, 2, 0x10), (W, 1, 5))
    assert message.endswith("R14 = 1005h (4101): linear ramps, speed steps of each curved end = 5h (5)")


def test_the_reset_command_clears_r6_where_the_chip_does():
    point = [(W, 0, 0x86), (W, 3, 1), (W, 2, 0), (W, 1, 0), (W, 0, 0x08), (W, 0, 0x86), (W, 1, 7)]
    assert after(PCL240K(), *point).endswith("R6 = 10007h (65543)")
    assert after(PCL240MS(), *point).endswith("R6 = 7h (7)")


@pytest.mark.parametrize("code", [0x18, 0x1D], ids=hex)
def test_a_command_with_start_and_stop_leaves_the_described_r6_as_it_is(code):
    """A stop command of the extension mode clears R6; 18h and 1Dh are starts as well."""
    chip = PCL240MK()
    point = [(W, 0, 0x86), (W, 3, 0), (W, 2, 1), (W, 1, 0), (W, 0, code), (W, 0, 0x86), (W, 1, 5)]
    assert after(chip, *point).endswith("R6 = 105h (261)")
    assert chip.values()["R6"] == 0x105


def test_a_counter_has_no_described_value_if_its_other_bytes_may_have_changed():
    chip = PCL240K()
    listener = chip.make_describer()
    for cycle in [(W, 0, 0x80), (W, 3, 0), (W, 2, 1), (W, 1, 0), (W, 0, 0x87), (W, 1, 2), (W, 0, 0x81), (W, 2, 16)]:
        received(chip, listener, cycle)
    received(chip, listener, (W, 0, 0x10))
    chip.advance(400)
    assert chip.values()["R0"] < 0x100
    received(chip, listener, (W, 0, 0x80))
    assert received(chip, listener, (W, 1, 5)) == "R0 bits 7..0 = 05h"
    assert [received(chip, listener, (W, a, 5)) for a in (3, 2, 1)][-1].endswith(": R0 = 50505h (328965)")


# --- NOVA ---


@pytest.mark.parametrize(
    ("make", "cycles", "sentence"),
    [
        (MCX304, [(W, 6, 4000), (W, 0, 0x0105)], "X: set drive speed V = 4000"),
        (MCX514, [(W, 6, 4000), (W, 0, 0x0305)], "X Y: set drive speed DV = 4000 pps"),
        (MCX514, [(W, 6, 0xFFEC), (W, 7, 0xFFFF), (W, 0, 0x0409)], "Z: set logical position counter LP = -20 pulses"),
        (MCX514, [(W, 6, 100), (W, 0, 0x0019)], "set maximum finish point of interpolation TX = 100 pulses"),
        (MCX514, [(W, 7, 0x1234)], "data 31..16 = 1234h"),
        (MCX514, [(W, 0, 0x0350)], "X Y: relative position drive"),
        (MCX304, [(W, 0, 0x0826)], "U: decelerating stop"),
        (MCX514, [(W, 0, 0x0185)], "X: enable SYNC0 SYNC2"),
        (MCX514, [(W, 0, 0x0155)], "X: 55h is no command of the MCX514"),
        (MCX302, [(W, 0, 0x0108)], "X: 08h is no command of the MCX302"),
        (MCX302, [(W, 0, 0x0520)], "X (no Z on the MCX302): + direction fixed pulse drive"),
        (MCX514, [(W, 0, 0x0050)], "to no axis, nothing happens: relative position drive"),
        (MCX514, [(W, 0, 0x01FF)], "X: nothing happens, it takes no axis bits: command reset"),
        (MCX514, [(W, 0, 0x00FF)], "command reset"),
        (MCX304, [(W, 0, 0x8000)], "reset"),
        (MCX514, [(W, 3, 0x0004)], "X: WR3 (drive mode and pulse signals): S-curves"),
        (MCX514, [(W, 0, 0x0A1F), (W, 3, 0x2000)],
         "Y U: WR3 (drive mode and pulse signals): triangle prevention of linear ramps: off"),
        (MCX514, [(W, 1, 0x0080)], "X: WR1 (interrupt enable): the drive ended"),
        (MCX302, [(W, 5, 1)], "WR5 is not used on the MCX302"),
        (MCX312, [(W, 5, 4)], "WR5: second axis: Y"),
        (MCX312, [(W, 0, 0x36), (W, 2, 0x80)], "BP1P = 0080h: steps of axis 1 in + direction"),
        (MCX514, [(W, 6, 0x0024), (W, 0, 0x0124)],
         "X: set automatic home search 2 H2M = 0024h: DCC width: 100 us, LP is cleared at the end"),
        (MCX514, [(W, 6, 0x0112), (W, 0, 0x0126)],
         "X: set synchronous action set 0 S0M = 0112h: action: decelerating stop, factor: timer up"),
    ],
)  # fmt: skip
def test_a_write_to_a_nova_chip_says_what_it_means(make, cycles, sentence):
    assert after(make(), *cycles) == sentence


@pytest.mark.parametrize(
    ("make", "address", "value", "sentence"),
    [
        (MCX514, 0, 0x0805, "RR0: the next segment can be written, X Z is driving"),
        (MCX304, 0, 0x0021, "RR0: Y: an error bit of RR1 or RR2 is set, X is driving"),
        (MCX514, 0, 0, "RR0: all bits 0"),
        (MCX514, 1, 0x0090, "X: RR1: the drive ended, the drive started"),
        (MCX304, 1, 0x1008, "X: RR1: ended by LMT+, speed is constant"),
        (MCX304, 2, 0x0304, "X: RR2: state of the home search: step 1: waits for STOP0, hardware limit +"),
        (MCX514, 3, 0x0001, "X: RR3 page 0: level of STOP0 high"),
        (MCX514, 4, 0x1200, "RR4: PIO7 to PIO0 of Y = 12h (18)"),
        (MCX514, 6, 0x1234, "data read, bits 15..0 = 1234h"),
    ],
)
def test_a_read_of_a_nova_chip_describes_the_fields_that_are_set(make, address, value, sentence):
    assert make().make_describer().read(address, value) == sentence


def test_rr3_of_the_mcx514_is_described_by_the_selected_page_of_its_axis():
    listener = MCX514().make_describer()
    assert listener.write(0, 0x027B) == "Y: RR3 shows page 1"
    assert listener.read(3, 0x20) == "Y: RR3 page 1: speed is constant"
    listener.write(0, 0x011F)
    assert listener.read(3, 0x20) == "X: RR3 page 0: level of INPOS high"


def test_rr6_and_rr7_are_described_as_the_register_that_the_command_read():
    chip = MCX304()
    cycles = [
        (W, 6, 0xFF00),
        (W, 7, 0xFFFF),
        (W, 0, 0x0209),
        (W, 0, 0x0210),
        (R, 6, 0),
        (R, 7, 0),
        (W, 0, 0x0212),
        (R, 6, 0),
    ]
    listener = chip.make_describer()
    assert [received(chip, listener, c) for c in cycles][3:] == [
        "Y: read logical position counter LP",
        "Y: LP bits 15..0 = FF00h",
        "Y: logical position counter LP = -256 pulses",
        "Y: read current speed CV",
        "Y: current speed CV = 0",
    ]


def test_on_the_8_bit_bus_a_byte_says_what_its_word_is_then():
    chip = MCX514()
    listeners = [chip.make_describer()]
    message = []
    for at, value in (
        (1, 0x01), (0, 0x50), (12, 0x0F), (13, 0x10), (4, 0x02), (5, 0x20), (1, 0x02), (0, 0x25), (5, 0x20),
    ):  # fmt: skip
        chip.write_byte(at, value)
        (expected,) = {listener.write(16 + at, value) for listener in listeners}
        listeners.append(chip.make_describer())
        message.append(expected)
    assert message == [
        "WR0 bits 15..8 = 01h: waits for bits 7..0",
        "X: relative position drive",
        "data 15..0 = 000Fh",
        "data 15..0 = 100Fh",
        "X: WR2 (input signals): STOP0 stops the drive",
        "X: WR2 (input signals): software limits stop the drive, STOP0 stops the drive",
        "WR0 bits 15..8 = 02h: waits for bits 7..0",
        "Y: set input signal filters FLM = 100Fh: time of FE6, FE7: 1 us, FE3, FE2, filter of LMT+, LMT-, filter of EMG",
        "Y: WR2 (input signals): software limits stop the drive",
    ]
    assert listeners[0].read(16, 0x01) == "RR0 bits 7..0: X is driving"
    assert listeners[0].read(17, 0x08) == "RR0 bits 15..8: the next segment can be written"


@pytest.mark.parametrize(("make", "reset"), [(MCX514, 0x00FF), (MCX304, 0x8000), (MCX312, 0x8000)])
def test_after_a_reset_command_a_nova_chip_is_described_as_after_power_up(make, reset):
    chip = make()
    listener = chip.make_describer()
    received(chip, listener, (W, 6, 0x1234))
    received(chip, listener, (W, 7, 0x1234))
    if make is MCX514:
        received(chip, listener, (W, 0, 0x027B))
    if make is MCX312:
        received(chip, listener, (W, 0, 0x0036))
    reading = chip.MAP.command("R-LP").code
    received(chip, listener, (W, 0, 0x0200 | reading))
    received(chip, listener, (W, 0, reset))
    new = make().make_describer()
    for cycle in [(R, 3, 1), (W, 3, 4), (R, 6, 0), *((W, k, 0x0123) for k in range(1, 8)), (W, 0, 0x0109)]:
        assert says(listener, cycle) == says(new, cycle)


# --- HCTL-1100 ---


@pytest.mark.parametrize(
    ("cycles", "sentence"),
    [
        ([(W, 0x05, 3)], "program counter: control"),
        ([(W, 0x05, 9)], "program counter: 09h is no mode of the HCTL1100"),
        ([(W, 0x00, 0x08)], "set F0: trapezoid mode"),
        ([(W, 0x00, 0x03)], "clear F3: proportional velocity mode"),
        ([(W, 0x00, 0x09)], "set F1: nothing changes, it can only be read (init/idle mode)"),
        ([(W, 0x00, 0x0E)], "set F6: no flag of the HCTL1100"),
        ([(W, 0x07, 2)],
         "status: the commutator counts quadrature counts, four phases; clears LIMIT and STOP if released"),
        ([(W, 0x22, 0x40)], "R22 = 40h (64): filter: gain K, in 1/4"),
        ([(W, 0x09, 0xD8)], "R09 = D8h (-40 %): PWM motor command; written in init/idle only"),
        ([(W, 0x0C, 0)], "R0C = 00h: command position, high byte; waits for R0E"),
        ([(W, 0x0C, 0), (W, 0x0D, 0x10), (W, 0x0E, 0x10)], "R0E = 10h: command position = 4112 counts"),
        ([(W, 0x2B, 0xFF), (W, 0x2A, 0xFF), (W, 0x29, 0x9C)], "R29 = 9Ch: final position = -100 counts"),
        ([(W, 0x26, 0x80), (W, 0x27, 2)], "R27 = 02h: acceleration = 2.5 counts/sample2"),
        ([(W, 0x23, 0x18), (W, 0x24, 0)], "R24 = 00h: proportional command velocity = 1.5 counts/sample"),
        ([(W, 0x13, 5)], "R13, any value: clears the actual position"),
        ([(W, 0x12, 5)], "R12 can only be read: nothing changes (actual position)"),
        ([(W, 0x30, 5)], "no register of the HCTL1100 at 30h: nothing changes"),
        ([(R, 0x00, 0)], "flags: init/idle mode"),
        ([(R, 0x07, 0)], "status: init/idle mode"),
        ([(R, 0x05, 0)], "R05 can only be written: reads 00h (program counter)"),
        ([(R, 0x30, 0)], "no register of the HCTL1100 at 30h: reads 00h"),
        ([(R, 0x14, 0)], "R14 = 00h: actual position, low byte; its read latches the other two"),
    ],
)  # fmt: skip
def test_a_cycle_of_the_hctl1100_says_what_it_means(cycles, sentence):
    assert after(HCTL1100(), *cycles) == sentence


def test_a_triggered_limit_is_described():
    chip = HCTL1100()
    chip.pins.limit = True
    assert after(chip, (R, 0x07, 0)) == "status: LIMIT has triggered, init/idle mode"


def test_the_actual_position_is_described_with_the_last_of_its_latched_bytes():
    chip = HCTL1100()
    chip.encoder = -5000
    message = [after(chip, *[(R, a, 0) for a in order]) for order in ((0x14, 0x13, 0x12), (0x14, 0x12, 0x13))]
    assert message == ["R12 = FFh: actual position = -5000 counts", "R13 = ECh: actual position = -5000 counts"]


# --- all of them ---


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("name", CHIPS.built_in)
def test_any_cycle_gets_a_short_line_of_ascii(name, seed):
    """Also cycles at no address of the chip, and what no chip would return."""
    chip, rng = CHIPS[name](), random.Random(seed)
    listener = chip.make_describer()
    for _ in range(1000):
        write, address, value = rng.random() < 0.6, rng.randrange(-1, 70), rng.randrange(-1, 1 << 17)
        message = says(listener, (write, address, value))
        where = f"seed {seed}: {'write' if write else 'read'} {value:#x} at {address}: {message!r}"
        assert 0 < len(message) <= MAX_LINE_LENGTH, where
        assert message.isascii(), where
        assert message.isprintable(), where


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("make", PCL)
def test_a_pcl240_register_holds_the_value_that_the_listener_describes(make, seed):
    chip, rng, expected = make(), random.Random(seed), 0
    listener = chip.make_describer()
    for _ in range(500):
        address = rng.randrange(4)
        value = rng.randrange(256)
        if address == 0 and rng.random() < 0.8:
            value = value & 0x3F | 0x80
        message = received(chip, listener, (W, address, value))
        if result := re.search(r": (R\d+) = ([0-9A-F]+)h \((\d+)\)", message):
            expected += 1
            assert chip.values()[result[1]] == int(result[2], 16) == int(result[3]), f"seed {seed}: {message}"
    assert expected > 30


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("make", NOVA)
def test_a_nova_register_reads_back_the_value_that_the_listener_describes(make, seed):
    chip, rng = make(), random.Random(seed)
    listener = chip.make_describer()
    reads = {c.symbol for c in chip.MAP.commands if c.kind == "data read"}
    readable = [
        r for r in chip.MAP.registers if f"R-{r.name}" in reads and not r.fields and r.name != "TX"
    ]  # TX: another's
    for r in rng.choices(readable, k=30):
        axis, word = rng.randrange(chip.AXES), rng.getrandbits(32)
        write, read = chip.MAP.command(r.name), chip.MAP.command(f"R-{r.name}")
        bits = 0x100 << axis if write.axes else 0
        cycles = [(W, 6, word & 0xFFFF), (W, 7, word >> 16), (W, 0, bits | write.code), (W, 0, bits | read.code)]
        written = [received(chip, listener, c) for c in cycles][2]
        assert f" {r.name} = {r.value(chip.read(6) | chip.read(7) << 16)}" in written, f"seed {seed}"
        received(chip, listener, (R, 6, 0))
        assert received(chip, listener, (R, 7, 0)) == written.replace("set ", ""), f"seed {seed}"


@pytest.mark.parametrize("seed", SEEDS)
def test_an_hctl1100_register_holds_the_value_that_the_listener_describes(seed):
    chip, rng, expected = HCTL1100(), random.Random(seed), 0
    listener = chip.make_describer()
    for _ in range(500):
        address = rng.choice((0x0C, 0x0D, 0x0E, 0x15, 0x16, 0x17, 0x29, 0x2A, 0x2B, 0x05))
        message = received(chip, listener, (W, address, rng.randrange(4 if address == 0x05 else 256)))
        if result := re.search(r": (.*) = (-?\d+) counts", message):
            expected += 1
            places = {"command position": "R0C R0D R0E", "final position": "R2B R2A R29"}.get(result[1], "R12 R13 R14")
            if result[1].startswith("preset"):
                chip.read(0x14)
            previous = chip.values()
            high, middle, low = (previous[place] for place in places.split())
            assert high << 16 | middle << 8 | low == int(result[2]) & 0xFFFFFF, f"seed {seed}: {message}"
    assert expected > 100


def program(make, rng):
    """Draw a random program, in parts within which no trace begins."""
    statement = _pcl240_statement if make in PCL else _hctl1100_statement if make is HCTL1100 else _nova_statement
    return [part for _ in range(40) for part in statement(make, rng)]


def _pcl240_statement(make, rng):
    if rng.random() < 0.3:
        return [[(W, 0, rng.choice((0x08, 0x15, 0x44, 0x49, 0xC0, 0xC8, 0xF0)))]]
    select = [[(W, 0, 0x80 | rng.randrange(64))]]
    return select + [[(W, a, rng.randrange(256))] for a in (3, 2, 1)] + [[(R, a, 0)] for a in (3, 2, 1, 0)]


def _nova_statement(make, rng):
    command = rng.choice([c for c in make.MAP.commands if not c.starts])
    word = rng.randrange(16) << 8 | rng.choice(command.codes)
    if command.kind == "data read":
        return [[(W, 0, word), (R, 6, 0), (R, 7, 0)]]
    data, words = ([[(W, n, rng.randrange(1 << 16))] for n in some] for some in ((6, 7), range(1, 6)))
    return [*data, [(W, 0, word)], *words, *([(R, n, 0)] for n in range(6))]


def _hctl1100_statement(make, rng):
    kind = rng.randrange(3)
    if kind == 0:
        return [[(W, rng.choice((0x05, 0x00)), rng.randrange(16))]]
    if kind == 1:
        return [[(R, a, 0)] for a in (0x14, 0x13, 0x12, 0x07)]
    numbers = (
        (0x0C, 0x0D, 0x0E),
        (0x15, 0x16, 0x17),
        (0x29, 0x2A, 0x2B),
        (0x23, 0x24),
        (0x26, 0x27),
        (0x20, 0x21, 0x22),
    )
    return [[(W, a, rng.randrange(256))] for a in rng.choice(numbers)]


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("name", CHIPS.built_in)
def test_a_listener_that_starts_in_the_middle_says_what_one_from_power_up_says(name, seed):
    """Anywhere but between a NOVA command that reads data and the reads of RR6 and RR7: the chip does not hold that command."""
    chip, rng = CHIPS[name](), random.Random(seed)
    listeners = [chip.make_describer()]
    for part in program(type(chip), rng):
        if rng.random() < 0.1:
            listeners.append(chip.make_describer())
        for cycle in part:
            expected = happen(chip, cycle)
            message = {says(listener, expected) for listener in listeners}
            assert len(message) == 1, f"seed {seed}: of {expected} they say {message}"
    assert len(listeners) > 2
