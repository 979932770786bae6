/* The pins and buses of pinbus.h, compiled once for all programs. */
#include <pinbus.h>

namespace pulsestage
{
uint8_t outputs_of(int at)
{
    const Pins &p = pins();
    return uint8_t((p.port[at] & ~p.timed[at]) | (p.timed_levels[at] & p.timed[at]));
}

bool level_of(int pin)
{
    const Pins &p = pins();
    int at = pin >> 3, bit = pin & 7;
    if (p.ddr[at] >> bit & 1)
        return outputs_of(at) >> bit & 1;
    return p.driven[at] >> bit & 1 ? p.level[at] >> bit & 1 : true;
}
} // namespace pulsestage

bool PinBus::low(int pin, bool none) { return pin < 0 ? none : !pulsestage::level_of(pin); }

uint32_t PinBus::where() const
{
    if (ale_ >= 0)
        return base_ + 1;
    uint32_t address = 0;
    for (int k = 0; k < n_address_; k++)
        address |= uint32_t(pulsestage::level_of(address_[k])) << k;
    return base_ + (n_data_ == 16 ? 2 * address : address);
}

int PinBus::inputs() const
{
    int n = 0;
    for (int k = 0; k < n_data_; k++)
        n += !(pulsestage::pins().ddr[data_[k] >> 3] >> (data_[k] & 7) & 1);
    return n;
}

unsigned PinBus::read_data() const
{
    const pulsestage::Pins &p = pulsestage::pins();
    if (whole_ && p.ddr[data_[0] >> 3] == 0xFF)
        return pulsestage::outputs_of(data_[0] >> 3);
    unsigned value = 0;
    for (int k = 0; k < n_data_; k++)
        value |= unsigned(pulsestage::level_of(data_[k])) << k;
    return value;
}

void PinBus::told_if_input(const char *what)
{
    if (inputs() && !told_) {
        told_ = true;
        ps_logf("pins: %s of the bus at %lXh is written while %d of its %d data pins are inputs; these are 1", what,
                (unsigned long)base_, inputs(), n_data_);
    }
}

void PinBus::drive(unsigned value, bool on)
{
    pulsestage::Pins &p = pulsestage::pins();
    if (on && inputs() < n_data_ && !fought_) {
        fought_ = true;
        ps_logf("pins: the bus at %lXh is read while %d of its %d data pins are outputs: two drive one wire",
                (unsigned long)base_, n_data_ - inputs(), n_data_);
    }
    for (int k = 0; k < n_data_; k++) {
        const int at = data_[k] >> 3;
        const uint8_t bit = uint8_t(1 << (data_[k] & 7));
        p.driven[at] = uint8_t(on ? p.driven[at] | bit : p.driven[at] & ~bit);
        p.level[at] = uint8_t(value >> k & 1 ? p.level[at] | bit : p.level[at] & ~bit);
    }
}

void PinBus::before()
{
    if (!serial_ && (writing_ || latching_))
        held_ = read_data();
}

void PinBus::after()
{
    if (serial_) {
        const bool selects = low(cs_, false);
        if (selects != writing_) {
            writing_ = selects;
            ps_out8(base_, selects ? 0 : 1);
            pulsestage::interrupt_line().look();
        }
        return;
    }
    const bool selected = low(cs_, true);
    const bool write = selected && (rw_ < 0 ? low(wr_, false) : low(rw_, false) && cs_ >= 0);
    const bool latch = low(ale_, false);
    const bool read = oe_ < 0 ? selected && (rw_ < 0 ? low(rd_, false) : !low(rw_, false)) : low(oe_, false);
    if (rw_ >= 0 && oe_ >= 0 && selected && !low(rw_, false))
        wanted_ = true; /* the chip fetches; OE shows it */
    const bool latched = latching_ && !latch, written = writing_ && !write;
    const bool begins = read && !reading_, ends = !read && reading_;
    latching_ = latch; /* before the cycles, in which an interrupt may come */
    writing_ = write;
    reading_ = read;
    if (latched) {
        told_if_input("an address");
        ps_out8(base_, uint8_t(held_));
    }
    if (written) {
        told_if_input("data");
        n_data_ == 16 ? ps_out16(where(), uint16_t(held_)) : ps_out8(where(), uint8_t(held_));
    }
    if (begins) {
        if (oe_ < 0 || rw_ < 0 || wanted_)
            fetched_ = n_data_ == 16 ? ps_in16(where()) : ps_in8(where());
        wanted_ = false;
        drive(fetched_, true);
    } else if (ends)
        drive(0, false);
    if (latched || written || begins)
        pulsestage::interrupt_line().look();
}

static bool rising(int mode) { return (mode == 0) | (mode == 3); } /* bits are taken as SCK rises */

bool PinBus::hears(int mode, uint32_t hz)
{
    const bool edge = mode_ < 0 || rising(mode_) == rising(mode);
    if (!told_ && !edge)
        ps_logf("pins: the chip on SPI at %lXh takes bits in mode %d, and they come in mode %d, at the other edge of SCK: it hears "
                "nothing, and FFh is read. SPI.beginTransaction(SPISettings(hz, MSBFIRST, SPI_MODE%d))",
                (unsigned long)base_, mode_, mode, mode_);
    told_ |= !edge;
    if (fastest_ && hz > fastest_ && !fought_) {
        fought_ = true;
        ps_logf("pins: SCK of %lu Hz, and the chip on SPI at %lXh takes %lu Hz at most; the bytes are exchanged all the same",
                (unsigned long)hz, (unsigned long)base_, (unsigned long)fastest_);
    }
    return edge;
}

namespace pulsestage
{
/* Counts how often pins rise, and how often the program sets pins high that are inputs; see struct pulsestage_pin_use. */
static void count_rises(const uint8_t &which, int at, uint8_t value)
{
    const Pins &p = pins();
    const bool is_port = &which == &p.port[at];
    const uint8_t set = uint8_t(value & ~which & ~p.buses[at] & ~(is_port ? p.timed[at] : 0));
    const uint8_t driven = uint8_t(set & (is_port ? p.ddr[at] : outputs_of(at)));
    for (int bit = 0; set >> bit; bit++) {
        pulsestage_pin_use.rises[at * 8 + bit] += driven >> bit & 1;
        pulsestage_pin_use.pull_ups[at * 8 + bit] += is_port & uint8_t(set & ~driven) >> bit & 1;
        if (!is_port && set >> bit & 1)
            pulsestage_pin_use.pull_ups[at * 8 + bit] = 0; /* now it is an output */
    }
}

void change(uint8_t &which, int at, uint8_t value)
{
    Pins &p = pins();
    (&which == &p.port[at] ? p.port_memory : p.ddr_memory)[at] = value;
    if (pulsestage_pins.lines)
        count_rises(which, at, value);
    if (!((which ^ value) & p.strobes[at])) {
        which = value;
        return;
    }
    const uint8_t driven = uint8_t((which ^ value) & p.lines[at]);
    for (PinBus *bus = p.first; bus; bus = bus->next())
        bus->before();
    which = value;
    for (PinBus *bus = p.first; bus; bus = bus->next())
        bus->after();
    if (driven)
        ps_drive_pins(at * 8, driven, outputs_of(at), p.ddr[at]);
}

void change_timed(int at, uint8_t timed, uint8_t levels)
{
    Pins &p = pins();
    const uint8_t before = outputs_of(at);
    p.timed[at] = timed, p.timed_levels[at] = levels;
    const uint8_t changed = uint8_t((before ^ outputs_of(at)) & p.ddr[at]), rising = uint8_t(changed & outputs_of(at));
    for (int bit = 0; pulsestage_pins.lines && rising >> bit; bit++)
        pulsestage_pin_use.rises[at * 8 + bit] += rising >> bit & 1;
    if (changed & p.lines[at])
        ps_drive_pins_(at * 8, changed & p.lines[at], outputs_of(at), p.ddr[at], 0);
}

/* At the beginning of a program: find the ports of the pins of --pins, and drive the levels that constructors have set. */
static void connect_lines()
{
    Pins &p = pins();
    pulsestage_pin_use.has_ports = 1;
    for (int64_t k = 0; k < pulsestage_pins.n_lines; k++) {
        pulsestage_line &line = pulsestage_pins.lines[k];
#if defined(PULSESTAGE_ARDUINO)
        if (line.is_number)
            line.pin = core_pin(line.pin);
#endif
        line.is_number = 0;
        if (line.pin >= PORTS * 8)
            continue;
        const uint8_t bit = uint8_t(1 << (line.pin & 7));
        (line.driven ? p.lines : p.switches)[line.pin >> 3] |= bit;
        if (line.driven)
            p.strobes[line.pin >> 3] |= bit;
    }
    for (int at = 0; at < PORTS; at++)
        if (p.lines[at] & p.ddr[at])
            ps_drive_pins(at * 8, p.lines[at], outputs_of(at), p.ddr[at]);
}

void said_if_unwired()
{
    connect_lines();
    if (!pins().first && pulsestage_pins.lines && !pulsestage_pins.n_lines)
        ps_log("pins: they drive no STEP/DIR axis without --pins x.step=D2,x.dir=D5; docs/step_dir.md");
    else if (!pins().first && !pulsestage_pins.n_lines)
        ps_log("pins: no PinBus says how a chip is wired to them, so no chip sees them (docs/porting.md); STEP/DIR axes "
               "need --chips stepdir --pins x.step=D2,x.dir=D5");
}

void note_reads(int at, uint8_t inputs)
{
    const Pins &p = pins();
    const bool is_whole = inputs & (inputs - 1);
    if (is_whole && (p.switches[at] | p.driven[at] | p.special[at]))
        return; /* for those that are driven */
    inputs &= uint8_t(~(p.switches[at] | p.driven[at] | p.special[at] | p.buses[at]));
    for (int bit = 0; inputs >> bit; bit++)
        if (inputs >> bit & 1)
            pulsestage_pin_reads.reads[at * 8 + bit] |= is_whole ? PS_PORT_READ : PS_PIN_READ;
}

uint8_t look(int at, uint8_t mask, int64_t cycle)
{
    const Pins &p = pins();
    if (p.renew && p.timed[at] & mask)
        p.renew();
    uint8_t value = uint8_t((outputs_of(at) & p.ddr[at]) | (~p.ddr[at] & (p.level[at] | ~p.driven[at])));
    const uint8_t switches = uint8_t(p.switches[at] & mask & ~p.ddr[at]);
    if (cycle)
        note_reads(at, uint8_t(mask & ~p.ddr[at]));
    if (switches)
        value = uint8_t((value & ~switches) | ps_read_pins(at * 8, switches, cycle));
    else if (!cycle)
        return value & mask;
    else if (p.special[at] & mask) {
        const bool asserted = ps_interrupt_line() != 0;
        value = uint8_t(asserted ? value & ~p.special[at] : value | p.special[at]);
    } else if (!(p.driven[at] & mask))
        ps_micros();
    return value & mask;
}

void follow_pointers()
{
    Pins &p = pins();
    finish_write();
    for (int at = 0; p.pointed && at < PORTS; at++) {
        if (p.ddr_memory[at] != p.ddr[at])
            change(p.ddr[at], at, p.ddr_memory[at]);
        if (p.port_memory[at] != p.port[at])
            change(p.port[at], at, p.port_memory[at]);
        if (!p.pointed_inputs[at])
            continue;
        const uint8_t toggled = p.input_memory[at];
        if (toggled != p.inputs_before[at]) {
            p.inputs_before[at] = toggled;
            change(p.port[at], at, uint8_t(p.port[at] ^ toggled));
        }
        p.input_memory[at] = p.inputs_before[at] = look(at, 0xFF, 0);
    }
}
volatile uint8_t *point_at_port(int at)
{
    pins().pointed = true;
    return &pins().port_memory[at];
}
volatile uint8_t *point_at_direction(int at)
{
    pins().pointed = true;
    return &pins().ddr_memory[at];
}
volatile uint8_t *point_at_inputs(int at)
{
    Pins &p = pins();
    p.pointed = p.pointed_inputs[at] = true;
    p.input_memory[at] = p.inputs_before[at] = look(at, 0xFF, 0);
    return &p.input_memory[at];
}
} // namespace pulsestage
