/* The EEPROM of an AVR, included by avr/io.h: that of an ATmega328P, or with -D__AVR_ATmega2560__ of an ATmega2560. EECR, EEDR, EEAR.
 *
 * It is erased (FFh) when a run begins. -DPULSESTAGE_EEPROM='"settings.eep"' keeps it in a file, which is read at the beginning, if it is
 * there, and written with each byte. A byte that is written takes 3.3 ms. */
#ifndef PULSESTAGE_AVR_EEPROM_REGISTERS_H
#define PULSESTAGE_AVR_EEPROM_REGISTERS_H

extern "C++" { /* also where a program in C is included */

#include <avr/io.h>
#include <stdio.h>
#include <string.h>

namespace pulsestage
{
enum { EEPROM_BYTE_US = 3300 };
struct Eeprom {
    uint8_t bytes[E2END + 1];
    uint16_t address; /* EEAR */
    uint8_t data;     /* EEDR */
    bool enabled;     /* EEMPE */
    uint64_t busy_until_ns;

    Eeprom() : address(0), data(0), enabled(false), busy_until_ns(0)
    {
        memset(bytes, 0xFF, sizeof bytes);
#if defined(PULSESTAGE_EEPROM)
        if (FILE *file = fopen(PULSESTAGE_EEPROM, "rb")) {
            const size_t size = fread(bytes, 1, sizeof bytes, file);
            (void)size; /* a shorter file leaves the rest erased */
            fclose(file);
        }
#endif
    }
    uint8_t &operator[](int at) { return bytes[at & E2END]; }
    /* Begins to write a byte, behind one that is being written; the program goes on. */
    void write(int at, uint8_t value)
    {
        wait();
        bytes[at & E2END] = value;
        busy_until_ns = ps_nanoseconds() + EEPROM_BYTE_US * 1000u;
#if defined(PULSESTAGE_EEPROM)
        FILE *file = fopen(PULSESTAGE_EEPROM, "wb");
        if (!file || fwrite(bytes, 1, sizeof bytes, file) != sizeof bytes)
            ps_log("EEPROM: its file cannot be written: " PULSESTAGE_EEPROM);
        if (file)
            fclose(file);
#endif
    }
    bool is_busy() const { return busy_until_ns > ps_nanoseconds(); }
    void wait()
    {
        const uint64_t now = ps_nanoseconds();
        if (busy_until_ns > now)
            ps_spend_ns(busy_until_ns - now);
    }
};
inline __attribute__((visibility("hidden"))) Eeprom &eeprom()
{
    static Eeprom one;
    return one;
}
struct EecrOf {
    static uint8_t read()
    {
        ps_micros(); /* a loop that waits for EEPE */
        return uint8_t(eeprom().is_busy() << EEPE | eeprom().enabled << EEMPE);
    }
    static void write(uint8_t v)
    {
        Eeprom &e = eeprom();
        if (v & 1 << EERE)
            e.data = e[e.address];
        if (v & 1 << EEPE && e.enabled)
            e.write(e.address, e.data);
        e.enabled = v & 1 << EEMPE && !(v & 1 << EEPE);
    }
};
struct EedrOf {
    static uint8_t read() { return eeprom().data; }
    static void write(uint8_t v) { eeprom().data = v; }
};
struct EearOf {
    static uint16_t read() { return eeprom().address; }
    static void write(uint16_t v) { eeprom().address = v & E2END; }
};
struct EearlOf {
    static uint8_t read() { return uint8_t(eeprom().address); }
    static void write(uint8_t v) { EearOf::write(uint16_t((eeprom().address & 0xFF00) | v)); }
};
struct EearhOf {
    static uint8_t read() { return uint8_t(eeprom().address >> 8); }
    static void write(uint8_t v) { EearOf::write(uint16_t((eeprom().address & 0xFF) | v << 8)); }
};
} // namespace pulsestage

static const pulsestage::Register<pulsestage::EecrOf> EECR __attribute__((unused)) = {};
static const pulsestage::Register<pulsestage::EedrOf> EEDR __attribute__((unused)) = {};
static const pulsestage::Register<pulsestage::EearlOf> EEARL __attribute__((unused)) = {};
static const pulsestage::Register<pulsestage::EearhOf> EEARH __attribute__((unused)) = {};
static const pulsestage::Count<pulsestage::EearOf> EEAR __attribute__((unused)) = {};

} /* extern "C++" */
#endif
