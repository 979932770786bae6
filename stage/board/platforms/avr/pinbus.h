/* pinbus.h: the pins of a microcontroller, and the chips whose buses hang on them.
 *
 * A pin is a bit of a port A to P: PIN_OF('B', 3). A `PinBus` says which pins are which signals of a chip's bus; from then on a change
 * of these pins makes bus cycles of the board (pulsestage.h), and a pin that the chip drives reads as the chip drives it.
 *
 *     #include <pinbus.h>
 *     static PinBus card = PinBus(0x300).data_port('A').address(PIN_OF('C', 0), PIN_OF('C', 1))
 *                              .cs(PIN_OF('G', 2)).wr(PIN_OF('G', 0)).rd(PIN_OF('G', 1));
 *
 * A write cycle is made when WR (or R/W with CS) ends; the data are those of just before. A read cycle is made when RD (or OE) begins,
 * and the chip drives the data pins until it ends. All strobes are asserted while low. Of a chip with ALE, the address goes to the base
 * port when ALE ends, and data are at the port behind. A pin that is an input is pulled up. C++11.
 *
 * A chip on SPI has its chip select pin alone; the bytes are those of Arduino's SPI.transfer:
 *
 *     static PinBus driver = PinBus(0x300).spi(10);
 *
 * A mode of SPI (0 to 3) and its fastest SCK may follow, as its data sheet has them: spi(10, 3, 4000000).
 * The board's port of its base is told of the pin (0 while it is low), and the port behind exchanges bytes: one written goes out, then
 * one read is what came in.
 *
 * Pins that `stage run --pins x.step=2,x.limit=!9` names are lines of STEP/DIR axes: a change of an output makes its edge at the end of
 * one bus cycle, and an input reads as the switch is.
 */
#ifndef PULSESTAGE_PINBUS_H
#define PULSESTAGE_PINBUS_H

extern "C++" { /* also where a program in C is included */

#include <interruptline.h>
#include <pulsestage.h>
#include <stdint.h>
#if defined(PULSESTAGE_ARDUINO)
#include <pins_arduino.h> /* numbers of pins on the board, as a sketch has them */
#endif

#define PIN_OF(letter, bit) (((letter) - 'A') * 8 + (bit))

class PinBus;

namespace pulsestage
{
enum { PORTS = 16, NO_PIN = -1 };

struct Pins {
    uint8_t port[PORTS], ddr[PORTS]; /* as the program wrote them */
    uint8_t driven[PORTS], level[PORTS]; /* which pins a chip drives, and how */
    uint8_t strobes[PORTS], special[PORTS]; /* pins whose change makes cycles; pins of the interrupt line */
    uint8_t lines[PORTS], switches[PORTS];  /* of strobes, those that drive lines of axes; pins that read switches of axes */
    uint8_t buses[PORTS];                   /* pins of buses of chips */
    uint8_t timed[PORTS], timed_levels[PORTS]; /* pins whose level a timer makes while they are outputs, and that level */
    void (*renew)();                        /* brings timed_levels up to now */
    bool pointed, pointed_inputs[PORTS];    /* whether the program has pointers to registers, and to those of inputs */
    uint8_t port_memory[PORTS], ddr_memory[PORTS], input_memory[PORTS], inputs_before[PORTS]; /* where they point, and the last
                                                                                             renewed levels */
    PinBus *first;
};

inline __attribute__((visibility("hidden"))) Pins &pins()
{
    static Pins all; /* zero from the beginning: before any constructor */
    return all;
}

/* The levels of pins that are outputs. */
inline uint8_t outputs_of(int at)
{
    const Pins &p = pins();
    return uint8_t((p.port[at] & ~p.timed[at]) | (p.timed_levels[at] & p.timed[at]));
}

inline bool level_of(int pin)
{
    const Pins &p = pins();
    int at = pin >> 3, bit = pin & 7;
    if (p.ddr[at] >> bit & 1)
        return outputs_of(at) >> bit & 1;
    return p.driven[at] >> bit & 1 ? p.level[at] >> bit & 1 : true;
}

inline void change(uint8_t &which, int at, uint8_t value);
} // namespace pulsestage

/* One chip's bus on the pins of a microcontroller; another chip on the same wires is another PinBus with its own CS. */
class PinBus
{
  public:
    /* base: the board's port of address 0 */
    explicit PinBus(uint32_t base) : base_(base) { enter(); }
    PinBus(const PinBus &other)
    {
        *this = other;
        enter();
    }
    PinBus &operator=(const PinBus &other) = default;
    ~PinBus()
    {
        for (PinBus **at = &pulsestage::pins().first; *at; at = &(*at)->next_)
            if (*at == this) {
                *at = next_;
                break;
            }
    }

    /* data pins, the lowest bit first: 8 of them, or 16 */
    template <typename... Pin> PinBus &data(Pin... pin)
    {
        static_assert(sizeof...(pin) == 8 || sizeof...(pin) == 16, "a data bus of 8 or 16 pins");
        const int given[] = {int(pin)...};
        for (n_data_ = 0; n_data_ < int(sizeof...(pin)); n_data_++)
            data_[n_data_] = reserve(number(given[n_data_]));
        whole_ = n_data_ == 8 && data_[0] % 8 == 0;
        for (int k = 1; whole_ && k < 8; k++)
            whole_ = data_[k] == data_[0] + k;
        return *this;
    }
    PinBus &data_port(char letter)
    {
        const int a = PIN_OF(letter, 0);
        raw_ = true;
        data(a, a + 1, a + 2, a + 3, a + 4, a + 5, a + 6, a + 7);
        raw_ = false;
        return *this;
    }
    /* address pins, the lowest bit first */
    template <typename... Pin> PinBus &address(Pin... pin)
    {
        const int given[] = {int(pin)...};
        for (n_address_ = 0; n_address_ < int(sizeof...(pin)) && n_address_ < MOST; n_address_++)
            address_[n_address_] = reserve(number(given[n_address_]));
        return *this;
    }
    PinBus &cs(int pin) { return strobe(cs_, pin); }   /* left out: always selected */
    PinBus &wr(int pin) { return strobe(wr_, pin); }
    PinBus &rd(int pin) { return strobe(rd_, pin); }
    PinBus &ale(int pin) { return strobe(ale_, pin); } /* address and data share the data pins */
    PinBus &rw(int pin) { return strobe(rw_, pin); }   /* R/W in place of WR: low while the chip is written */
    PinBus &oe(int pin) { return strobe(oe_, pin); }   /* with R/W: low while the chip drives the data pins */
    /* a chip on SPI, with this chip select pin; its mode, -1: not said; its fastest SCK, 0: not said */
    PinBus &spi(int pin, int mode = -1, uint32_t hz = 0)
    {
        serial_ = true;
        mode_ = mode;
        fastest_ = hz;
        return strobe(cs_, pin);
    }
    PinBus &irq(int pin)                               /* the board's interrupt line, low while it is asserted */
    {
        irq_ = number(pin);
        pulsestage::pins().special[irq_ >> 3] |= uint8_t(1 << (irq_ & 7));
        return *this;
    }

    void before() /* strobes are about to change */
    {
        if (!serial_ && (writing_ || latching_))
            held_ = read_data();
    }

    void after()
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

    bool selected() const { return serial_ && writing_; } /* on SPI, with its pin low */

    /* Does a selected chip take bits that come in this mode, at this rate? What is wrong is said once. */
    bool hears(int mode, uint32_t hz)
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

    /* A byte of SPI: what the selected chip answers. */
    uint8_t exchange(uint8_t sent)
    {
        ps_out8(base_ + 1, sent);
        return ps_in8(base_ + 1);
    }

    PinBus *next() const { return next_; }

  private:
    enum { MOST = 16 };

    void enter() { next_ = pulsestage::pins().first, pulsestage::pins().first = this; }

    int number(int pin) const
    {
#if defined(PULSESTAGE_ARDUINO)
        if (!raw_)
            return pulsestage::core_pin(pin);
#endif
        return pin;
    }

    static int reserve(int pin)
    {
        pulsestage::pins().buses[pin >> 3] |= uint8_t(1 << (pin & 7));
        return pin;
    }

    PinBus &strobe(int &which, int pin)
    {
        which = reserve(number(pin));
        pulsestage::pins().strobes[which >> 3] |= uint8_t(1 << (which & 7));
        return *this;
    }

    static bool rising(int mode) { return (mode == 0) | (mode == 3); } /* bits are taken as SCK rises */

    static bool low(int pin, bool none) { return pin < 0 ? none : !pulsestage::level_of(pin); }

    uint32_t where() const
    {
        if (ale_ >= 0)
            return base_ + 1;
        uint32_t address = 0;
        for (int k = 0; k < n_address_; k++)
            address |= uint32_t(pulsestage::level_of(address_[k])) << k;
        return base_ + (n_data_ == 16 ? 2 * address : address);
    }

    unsigned read_data() const
    {
        const pulsestage::Pins &p = pulsestage::pins();
        if (whole_ && p.ddr[data_[0] >> 3] == 0xFF)
            return pulsestage::outputs_of(data_[0] >> 3);
        unsigned value = 0;
        for (int k = 0; k < n_data_; k++)
            value |= unsigned(pulsestage::level_of(data_[k])) << k;
        return value;
    }

    int inputs() const
    {
        int n = 0;
        for (int k = 0; k < n_data_; k++)
            n += !(pulsestage::pins().ddr[data_[k] >> 3] >> (data_[k] & 7) & 1);
        return n;
    }

    void told_if_input(const char *what)
    {
        if (inputs() && !told_) {
            told_ = true;
            ps_logf("pins: %s of the bus at %lXh is written while %d of its %d data pins are inputs; these are 1", what,
                    (unsigned long)base_, inputs(), n_data_);
        }
    }

    void drive(unsigned value, bool on)
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

    uint32_t base_ = 0;
    int data_[MOST] = {}, address_[MOST] = {}, n_data_ = 0, n_address_ = 0;
    int cs_ = -1, wr_ = -1, rd_ = -1, ale_ = -1, rw_ = -1, oe_ = -1, irq_ = -1;
    int mode_ = -1;
    uint32_t fastest_ = 0;
    unsigned held_ = 0, fetched_ = 0;
    bool whole_ = false, raw_ = false, writing_ = false, reading_ = false, latching_ = false, wanted_ = false;
    bool told_ = false, fought_ = false, serial_ = false;
    PinBus *next_ = nullptr;
};

namespace pulsestage
{
/* Counts how often pins rise, and how often the program sets pins high that are inputs; see struct pulsestage_pin_use. */
inline void count_rises(const uint8_t &which, int at, uint8_t value)
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

/* The program writes a port, or a direction; strobes may have changed. */
inline void change(uint8_t &which, int at, uint8_t value)
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

/* A timer makes the levels of these pins of a port from now on, without a bus cycle. */
inline void change_timed(int at, uint8_t timed, uint8_t levels)
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
inline void connect_lines()
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

/* At the beginning of a program: nothing it does to its pins would reach a chip. */
inline void said_if_unwired()
{
    connect_lines();
    if (!pins().first && pulsestage_pins.lines && !pulsestage_pins.n_lines)
        ps_log("pins: they drive no STEP/DIR axis without --pins x.step=D2,x.dir=D5; docs/step_dir.md");
    else if (!pins().first && !pulsestage_pins.n_lines)
        ps_log("pins: no PinBus says how a chip is wired to them, so no chip sees them (docs/porting.md); STEP/DIR axes "
               "need --chips stepdir --pins x.step=D2,x.dir=D5");
}

/* Remembers for the report that the program reads these inputs of a port, where nothing drives them. */
inline void note_reads(int at, uint8_t inputs)
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

/* What the program reads of a port, these bits of it. A pin that no bus drives costs a look at the clock, so that a loop which waits
 * for it goes on; `cycle` = 0: at once, without a bus cycle. */
inline uint8_t look(int at, uint8_t mask = 0xFF, int64_t cycle = PS_WITH_CYCLE)
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

/* Pointers to the registers of a port. A write through them reaches the pins, and what they read is renewed, at the next call that is
 * about pins, timers or time; a pulse that begins and ends between two such calls is not seen, nor is a write to PINx of what it reads. */
inline void follow_pointers()
{
    Pins &p = pins();
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
inline volatile uint8_t *point_at_port(int at)
{
    pins().pointed = true;
    return &pins().port_memory[at];
}
inline volatile uint8_t *point_at_direction(int at)
{
    pins().pointed = true;
    return &pins().ddr_memory[at];
}
inline volatile uint8_t *point_at_inputs(int at)
{
    Pins &p = pins();
    p.pointed = p.pointed_inputs[at] = true;
    p.input_memory[at] = p.inputs_before[at] = look(at, 0xFF, 0);
    return &p.input_memory[at];
}
} // namespace pulsestage

} /* extern "C++" */
#endif
