/* Print, Stream and the serial ports of HardwareSerial.h, compiled once for all sketches. */
#include <Arduino.h>

size_t Print::write(const uint8_t *bytes, size_t n)
{
    for (size_t k = 0; k < n; k++)
        write(bytes[k]);
    return n;
}

size_t Print::print(double v, int places) { return print(String(v, places)); }
size_t Print::print(unsigned char v, int base) { return print(String(v, base)); }
size_t Print::print(int v, int base) { return print(String(v, base)); }
size_t Print::print(unsigned v, int base) { return print(String(v, base)); }
size_t Print::print(long v, int base) { return print(String(v, base)); }
size_t Print::print(unsigned long v, int base) { return print(String(v, base)); }
size_t Print::print(long long v, int base) { return print(String(long(v), base)); }
size_t Print::print(unsigned long long v, int base) { return print(String((unsigned long)v, base)); }

size_t Print::printf(const char *format, ...)
{
    char text[1024];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    return write(text);
}

String Stream::readStringUntil(char end)
{
    String text;
    for (int c; (c = next()) >= 0 && c != end;)
        text += char(c);
    return text;
}

String Stream::readString()
{
    String text;
    for (int c; (c = next()) >= 0;)
        text += char(c);
    return text;
}

size_t Stream::readBytesUntil(char end, char *to, size_t n)
{
    size_t k = 0;
    for (int c; k < n && (c = next()) >= 0 && c != end;)
        to[k++] = char(c);
    return k;
}

size_t Stream::readBytes(char *to, size_t n)
{
    size_t k = 0;
    for (int c; k < n && (c = next()) >= 0;)
        to[k++] = char(c);
    return k;
}

long Stream::parseInt() { return strtol(number(false).c_str(), nullptr, 10); }

float Stream::parseFloat() { return strtof(number(true).c_str(), nullptr); }

static bool is_digit(int c) { return c >= '0' && c <= '9'; }

String Stream::number(bool point)
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

int Stream::look()
{
    int c = peek();
    if (c >= 0)
        return c;
    const uint64_t end = ps_micros() + 1000 * uint64_t(timeout_ms_);
    while ((c = peek()) < 0 && ps_micros() < end)
        ps_delay_us(20);
    return c;
}

void HardwareSerial::begin(unsigned long bits_per_second, int)
{
    ps_serial_line_rate(line_, uint32_t(bits_per_second));
    port().control = BOTH_ON;
}

size_t HardwareSerial::write(uint8_t c) { return port().send(char(c)), 1; }

int HardwareSerial::available()
{
    const int n = port().available();
    return n < 63 ? n : 63;
}

int HardwareSerial::read() { return port().take(); }

int HardwareSerial::peek() { return port().peek(); }
