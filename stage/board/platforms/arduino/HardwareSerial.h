/* HardwareSerial.h on an emulated board: Serial prints to the log of the run, line by line, and to the serial line of the board
 * (docs/serial.md). It reads what -DPULSESTAGE_SERIAL_INPUT='"..."' or Serial.feed says, and then what comes over that line, at the rate
 * of Serial.begin. Serial1 to Serial3 have lines of their own, and do not print to the log. To print takes no time; a look for a byte that is not there takes a bus cycle. */
#ifndef PULSESTAGE_HARDWARESERIAL_H
#define PULSESTAGE_HARDWARESERIAL_H

extern "C++" { /* also where a program in C is included */

#include <WString.h>
#include <serialline.h>
#include <stdarg.h>
#include <string.h>

class Print;

/* What prints itself. */
class Printable
{
  public:
    virtual ~Printable() {}
    virtual size_t printTo(Print &printer) const = 0;
};

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
    size_t print(const Printable &what) { return what.printTo(*this); }
    size_t print(char c) { return write(uint8_t(c)); }
    size_t print(double v, int places = 2) { return print(String(v, places)); }
    size_t print(unsigned char v, int base = 10) { return print(String(v, base)); }
    size_t print(int v, int base = 10) { return print(String(v, base)); }
    size_t print(unsigned v, int base = 10) { return print(String(v, base)); }
    size_t print(long v, int base = 10) { return print(String(v, base)); }
    size_t print(unsigned long v, int base = 10) { return print(String(v, base)); }
    size_t print(long long v, int base = 10) { return print(String(long(v), base)); }
    size_t print(unsigned long long v, int base = 10) { return print(String((unsigned long)v, base)); }
    size_t println() { return write("\r\n"); }
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
    virtual int availableForWrite() { return 0; }
    int getWriteError() { return write_error_; }
    void clearWriteError() { write_error_ = 0; }

  protected:
    void setWriteError(int error = 1) { write_error_ = error; }

  private:
    int write_error_ = 0;
};

class Stream : public Print
{
  public:
    virtual int available() = 0;
    virtual int read() = 0;
    virtual int peek() = 0;
    void setTimeout(unsigned long ms) { timeout_ms_ = ms; }
    String readStringUntil(char end)
    {
        String text;
        for (int c; (c = next()) >= 0 && c != end;)
            text += char(c);
        return text;
    }
    String readString()
    {
        String text;
        for (int c; (c = next()) >= 0;)
            text += char(c);
        return text;
    }
    size_t readBytesUntil(char end, char *to, size_t n)
    {
        size_t k = 0;
        for (int c; k < n && (c = next()) >= 0 && c != end;)
            to[k++] = char(c);
        return k;
    }
    size_t readBytes(char *to, size_t n)
    {
        size_t k = 0;
        for (int c; k < n && (c = next()) >= 0;)
            to[k++] = char(c);
        return k;
    }
    size_t readBytes(uint8_t *to, size_t n) { return readBytes(reinterpret_cast<char *>(to), n); }
    size_t readBytesUntil(char end, uint8_t *to, size_t n) { return readBytesUntil(end, reinterpret_cast<char *>(to), n); }
    unsigned long getTimeout() const { return timeout_ms_; }
    long parseInt() { return strtol(number(false).c_str(), nullptr, 10); }
    float parseFloat() { return strtof(number(true).c_str(), nullptr); }

  private:
    static bool is_digit(int c) { return c >= '0' && c <= '9'; }
    String number(bool point)
    {
        String text;
        int c;
        while ((c = look()) >= 0 && !is_digit(c) && c != '-')
            read();
        while (c >= 0 && (is_digit(c) || (text.isEmpty() && c == '-') || (point && c == '.'))) {
            text += char(read());
            c = look();
        }
        return text;
    }
    /* The next byte, for which they wait as long as setTimeout says; -1: none has come. */
    int look()
    {
        int c = peek();
        if (c >= 0)
            return c;
        const uint64_t end = ps_micros() + 1000 * uint64_t(timeout_ms_);
        while ((c = peek()) < 0 && ps_micros() < end)
            ps_delay_us(20);
        return c;
    }
    int next() { return look() < 0 ? -1 : read(); }
    unsigned long timeout_ms_ = 1000;
};

class HardwareSerial : public Stream
{
  public:
    explicit HardwareSerial(int line = 0) : line_(line) {} /* the number of the board's serial line */
    void begin(unsigned long bits_per_second, int = 0)
    {
        ps_serial_line_rate(line_, uint32_t(bits_per_second));
        port().control = BOTH_ON;
    }
    void end() { port().control = 0; }
    operator bool() const { return true; }
    using Print::write;
    size_t write(uint8_t c) override { return port().send(char(c)), 1; }
    int available() override
    {
        const int n = port().available();
        return n < 63 ? n : 63;
    }
    int availableForWrite() override { return 63; }
    int read() override { return port().take(); }
    int peek() override { return port().peek(); }
    /* What is received from now on; the text stays the caller's. */
    void feed(const char *text) { port().input = text; }

  private:
    enum { BOTH_ON = pulsestage::SerialLine::TRANSMITTER | pulsestage::SerialLine::RECEIVER };
    pulsestage::SerialLine &port() const { return pulsestage::serial_line(line_); }
    int line_;
};

#define SERIAL_8N1 0x06
static HardwareSerial Serial __attribute__((unused)), Serial1 __attribute__((unused))(1), Serial2 __attribute__((unused))(2),
    Serial3 __attribute__((unused))(3);
#define HAVE_HWSERIAL0
#if defined(__AVR_ATmega2560__)
#define HAVE_HWSERIAL1
#define HAVE_HWSERIAL2
#define HAVE_HWSERIAL3
#endif

} /* extern "C++" */
#endif
