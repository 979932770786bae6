/* pulsestage_mmio.hpp: memory-mapped registers in C++ whose accesses are bus cycles, on any system and at full speed.
 *
 *     #include <pulsestage_mmio.hpp>
 *     #define WR0 ps::reg16(0x300)           // was (*(volatile uint16_t *)0x40021000)
 *     WR0 = 0x010f;                          // a write cycle of 16 bits
 *     while (WR0 & 1) ;                      // read cycles
 *     WR0 |= 4;                              // a read cycle and a write cycle
 *
 * A struct of registers keeps its form; ps::cell8, ps::cell16, ps::cell32 take the place of its `volatile` types:
 *
 *     struct chip { ps::cell16 wr0, wr1, wr2; };
 *     #define CHIP ((chip *)0x300)           // where its first port is
 *     CHIP->wr1 = 5;                         // port 302h
 *
 * If the pointer has to stay what it is, define before the include which address stands for which port:
 * PULSESTAGE_MMIO_ADDRESS (0x40021000) and PULSESTAGE_MMIO_PORT (0x300).
 */
#ifndef PULSESTAGE_MMIO_HPP
#define PULSESTAGE_MMIO_HPP

#include <pulsestage.h>

#ifndef PULSESTAGE_MMIO_ADDRESS
#define PULSESTAGE_MMIO_ADDRESS 0
#endif
#ifndef PULSESTAGE_MMIO_PORT
#define PULSESTAGE_MMIO_PORT 0
#endif

namespace ps {

template <class T> struct bus;
template <> struct bus<uint8_t> {
    static uint8_t read(uint32_t port) { return ps_in8(port); }
    static void write(uint32_t port, uint8_t value) { ps_out8(port, value); }
};
template <> struct bus<uint16_t> {
    static uint16_t read(uint32_t port) { return ps_in16(port); }
    static void write(uint32_t port, uint16_t value) { ps_out16(port, value); }
};
template <> struct bus<uint32_t> {
    static uint32_t read(uint32_t port) { return ps_in32(port); }
    static void write(uint32_t port, uint32_t value) { ps_out32(port, value); }
};

/* What a register of type T can do. Register: the class that has it, with a function `port`. An assignment has the value that was
 * written; it is not read back. */
template <class Register, class T> class access {
    uint32_t at() const { return static_cast<const Register *>(this)->port(); }
    T put(T value) const
    {
        bus<T>::write(at(), value);
        return value;
    }

public:
    operator T() const { return bus<T>::read(at()); }
    T operator=(T value) const { return put(value); }
    T operator=(const access &other) const { return put(T(other)); }
    access() = default;
    access(const access &) = default;
#define PULSESTAGE_OPERATOR(op) \
    template <class V> T operator op##=(V value) const { return put(T(T(*this) op value)); }
    PULSESTAGE_OPERATOR(|)
    PULSESTAGE_OPERATOR(&)
    PULSESTAGE_OPERATOR(^)
    PULSESTAGE_OPERATOR(+)
    PULSESTAGE_OPERATOR(-)
    PULSESTAGE_OPERATOR(*)
    PULSESTAGE_OPERATOR(/)
    PULSESTAGE_OPERATOR(%)
    PULSESTAGE_OPERATOR(<<)
    PULSESTAGE_OPERATOR(>>)
#undef PULSESTAGE_OPERATOR
    T operator++() const { return put(T(T(*this) + 1)); }
    T operator--() const { return put(T(T(*this) - 1)); }
    T operator++(int) const
    {
        T before = *this;
        put(T(before + 1));
        return before;
    }
    T operator--(int) const
    {
        T before = *this;
        put(T(before - 1));
        return before;
    }
};

/* the register at a port */
template <class T> class reg : public access<reg<T>, T> {
    uint32_t port_;

public:
    explicit reg(uint32_t port) : port_(port) {}
    reg(const reg &) = default;
    uint32_t port() const { return port_; }
    using access<reg<T>, T>::operator=;
    T operator=(const reg &other) const { return *this = T(other); }
};

/* a register whose own address says the port; there is no memory, and none is touched */
template <class T> class cell : public access<cell<T>, T> {
    T room_;

public:
    uint32_t port() const
    {
        return (uint32_t)((uintptr_t)this - (uintptr_t)(PULSESTAGE_MMIO_ADDRESS) + (uintptr_t)(PULSESTAGE_MMIO_PORT));
    }
    using access<cell<T>, T>::operator=;
    T operator=(const cell &other) const { return *this = T(other); }
};

typedef reg<uint8_t> reg8;
typedef reg<uint16_t> reg16;
typedef reg<uint32_t> reg32;
typedef cell<uint8_t> cell8;
typedef cell<uint16_t> cell16;
typedef cell<uint32_t> cell32;
static_assert(sizeof(cell8) == 1 && sizeof(cell16) == 2 && sizeof(cell32) == 4, "a cell is as long as its register");

}
#endif
