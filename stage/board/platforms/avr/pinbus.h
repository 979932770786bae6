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

#ifndef __cplusplus
#error "pinbus.h is C++ here: build with --platform"
#endif

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
    void (*finish_write)();                 /* lets the last write of a program in C take effect; 0: there is none */
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
uint8_t outputs_of(int at);
bool level_of(int pin);
/* The program writes a port, or a direction; strobes may have changed. */
void change(uint8_t &which, int at, uint8_t value);
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

    void before(); /* strobes are about to change */
    void after();

    bool selected() const { return serial_ && writing_; } /* on SPI, with its pin low */

    /* Does a selected chip take bits that come in this mode, at this rate? What is wrong is said once. */
    bool hears(int mode, uint32_t hz);

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

    static bool low(int pin, bool none);
    uint32_t where() const;
    unsigned read_data() const;
    int inputs() const;
    void told_if_input(const char *what);
    void drive(unsigned value, bool on);

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
/* pinbus.cpp has the functions. A timer makes the levels of these pins of a port from now on, without a bus cycle. */
void change_timed(int at, uint8_t timed, uint8_t levels);
/* At the beginning of a program: find the ports of the pins of --pins, drive the levels that constructors have set, and say in the log
 * if nothing the program does to its pins would reach a chip. */
void said_if_unwired();
/* Remembers for the report that the program reads these inputs of a port, where nothing drives them. */
void note_reads(int at, uint8_t inputs);
/* What the program reads of a port, these bits of it. A pin that no bus drives costs a look at the clock, so that a loop which waits
 * for it goes on; `cycle` = 0: at once, without a bus cycle. */
uint8_t look(int at, uint8_t mask = 0xFF, int64_t cycle = PS_WITH_CYCLE);
inline void finish_write()
{
    if (pins().finish_write)
        pins().finish_write();
}
/* Pointers to the registers of a port. A write through them reaches the pins, and what they read is renewed, at the next call that is
 * about pins, timers or time; a pulse that begins and ends between two such calls is not seen, nor is a write to PINx of what it reads. */
void follow_pointers();
volatile uint8_t *point_at_port(int at);
volatile uint8_t *point_at_direction(int at);
volatile uint8_t *point_at_inputs(int at);
} // namespace pulsestage

} /* extern "C++" */
#endif
