/* HardwareSerial.h on an emulated board: Serial prints to the log of the run, line by line, and reads what
 * -DPULSESTAGE_SERIAL_INPUT='"..."' or Serial.feed says. It takes no time; a look for a byte that is not there takes a bus cycle. */
#ifndef PULSESTAGE_HARDWARESERIAL_H
#define PULSESTAGE_HARDWARESERIAL_H

extern "C++" { /* also where a program in C is included */

#include <WString.h>
#include <serialline.h>
#include <stdarg.h>
#include <string.h>

class Print
{
  public:
    virtual ~Print() {}
    virtual size_t write(uint8_t c) = 0;
    size_t write(const char *text) { return write(reinterpret_cast<const uint8_t *>(text), strlen(text)); }
    size_t write(const char *text, size_t n) { return write(reinterpret_cast<const uint8_t *>(text), n); }
    virtual size_t write(const uint8_t *bytes, size_t n)
    {
        for (size_t k = 0; k < n; k++)
            write(bytes[k]);
        return n;
    }
    size_t print(const char *text) { return write(text); }
    size_t print(const __FlashStringHelper *text) { return write(reinterpret_cast<const char *>(text)); }
    size_t print(const String &text) { return write(text.c_str()); }
    size_t print(char c) { return write(uint8_t(c)); }
    size_t print(double v, int places = 2) { return print(String(v, places)); }
    size_t print(unsigned char v, int base = 10) { return print(String(v, base)); }
    size_t print(int v, int base = 10) { return print(String(v, base)); }
    size_t print(unsigned v, int base = 10) { return print(String(v, base)); }
    size_t print(long v, int base = 10) { return print(String(v, base)); }
    size_t print(unsigned long v, int base = 10) { return print(String(v, base)); }
    size_t print(long long v, int base = 10) { return print(String(long(v), base)); }
    size_t print(unsigned long long v, int base = 10) { return print(String((unsigned long)v, base)); }
    size_t println() { return write(uint8_t('\n')); }
    template <typename What> size_t println(const What &what) { return print(what) + println(); }
    template <typename What> size_t println(const What &what, int how) { return print(what, how) + println(); }
    size_t printf(const char *format, ...) __attribute__((format(printf, 2, 3)))
    {
        char text[1024];
        va_list arguments;
        va_start(arguments, format);
        vsnprintf(text, sizeof text, format, arguments);
        va_end(arguments);
        return write(text);
    }
    virtual void flush() {}
};

class Stream : public Print
{
  public:
    virtual int available() = 0;
    virtual int read() = 0;
    virtual int peek() = 0;
    void setTimeout(unsigned long) {}
    String readStringUntil(char end)
    {
        String text;
        for (int c; (c = read()) >= 0 && c != end;)
            text += char(c);
        return text;
    }
    String readString()
    {
        String text;
        for (int c; (c = read()) >= 0;)
            text += char(c);
        return text;
    }
    size_t readBytesUntil(char end, char *to, size_t n)
    {
        size_t k = 0;
        for (int c; k < n && (c = read()) >= 0 && c != end;)
            to[k++] = char(c);
        return k;
    }
    size_t readBytes(char *to, size_t n)
    {
        size_t k = 0;
        for (int c; k < n && (c = read()) >= 0;)
            to[k++] = char(c);
        return k;
    }
    long parseInt() { return strtol(number(false).c_str(), nullptr, 10); }
    float parseFloat() { return strtof(number(true).c_str(), nullptr); }

  private:
    String number(bool point)
    {
        String text;
        while (peek() >= 0 && !(peek() >= '0' && peek() <= '9') && peek() != '-')
            read();
        while ((peek() >= '0' && peek() <= '9') || (text.isEmpty() && peek() == '-') || (point && peek() == '.'))
            text += char(read());
        return text;
    }
};

class HardwareSerial : public Stream
{
  public:
    void begin(unsigned long, int = 0) {}
    void end() {}
    operator bool() const { return true; }
    using Print::write;
    size_t write(uint8_t c) override { return pulsestage::serial_line().send(char(c)), 1; }
    int available() override
    {
        const size_t left = strlen(pulsestage::serial_line().left());
        if (!left)
            ps_micros();
        return left < 63 ? int(left) : 63;
    }
    int availableForWrite() { return 63; }
    int read() override { return pulsestage::serial_line().take(); }
    int peek() override
    {
        const char *left = pulsestage::serial_line().left();
        return *left ? uint8_t(*left) : -1;
    }
    /* What is received from now on; the text stays the caller's. */
    void feed(const char *text) { pulsestage::serial_line().input = text; }
};

#define SERIAL_8N1 0x06
static HardwareSerial Serial __attribute__((unused)), Serial1 __attribute__((unused));

} /* extern "C++" */
#endif
