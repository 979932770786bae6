/* WString.h on an emulated board: Arduino's String. */
#ifndef PULSESTAGE_WSTRING_H
#define PULSESTAGE_WSTRING_H

#ifndef __cplusplus
#error "WString.h is C++ here: build with --platform"
#endif

extern "C++" { /* also where a program in C is included */

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string>

class __FlashStringHelper;
#define F(text) (reinterpret_cast<const __FlashStringHelper *>(text))

namespace pulsestage
{
inline std::string digits(unsigned long long value, int base)
{
    if (base < 2 || base > 36)
        base = 10;
    std::string text;
    do
        text.insert(text.begin(), "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZ"[value % unsigned(base)]);
    while (value /= unsigned(base));
    return text;
}
/* As on an AVR: in a base other than 10 a negative number is its 32 bits. */
inline std::string number(long long value, int base)
{
    if (base < 2 || base > 36)
        base = 10;
    if (value < 0 && base != 10)
        return digits(uint32_t(value), base);
    return value < 0 ? "-" + digits(0ull - (unsigned long long)value, base) : digits((unsigned long long)value, base);
}
inline std::string fraction(double value, int places)
{
    char text[400];
    snprintf(text, sizeof text, "%.*f", places < 0 ? 0 : places > 30 ? 30 : places, value);
    return text;
}
} // namespace pulsestage

class String
{
  public:
    String(const char *text = "") : s_(text ? text : "") {}
    String(const __FlashStringHelper *text) : s_(reinterpret_cast<const char *>(text)) {}
    explicit String(char c) : s_(1, c) {}
    explicit String(unsigned char v, int base = 10) : s_(pulsestage::number(v, base)) {}
    explicit String(int v, int base = 10) : s_(pulsestage::number(v, base)) {}
    explicit String(unsigned v, int base = 10) : s_(pulsestage::number(v, base)) {}
    explicit String(long v, int base = 10) : s_(pulsestage::number(v, base)) {}
    explicit String(unsigned long v, int base = 10) : s_(pulsestage::digits(v, base)) {}
    explicit String(float v, int places = 2) : s_(pulsestage::fraction(v, places)) {}
    explicit String(double v, int places = 2) : s_(pulsestage::fraction(v, places)) {}

    const char *c_str() const { return s_.c_str(); }
    unsigned length() const { return unsigned(s_.size()); }
    bool isEmpty() const { return s_.empty(); }
    bool reserve(unsigned n) { return s_.reserve(n), true; }
    char charAt(unsigned k) const { return k < s_.size() ? s_[k] : '\0'; }
    char operator[](unsigned k) const { return charAt(k); }
    char &operator[](unsigned k) { return s_[k]; }
    void setCharAt(unsigned k, char c)
    {
        if (k < s_.size())
            s_[k] = c;
    }
    int indexOf(char c, unsigned from = 0) const { return at(s_.find(c, from)); }
    int indexOf(const String &text, unsigned from = 0) const { return at(s_.find(text.s_, from)); }
    int lastIndexOf(char c) const { return at(s_.rfind(c)); }
    String substring(unsigned from) const { return substring(from, length()); }
    String substring(unsigned from, unsigned to) const
    {
        if (from > to)
            std::swap(from, to);
        return from < s_.size() ? String(s_.substr(from, to - from).c_str()) : String();
    }
    bool startsWith(const String &text) const { return s_.compare(0, text.s_.size(), text.s_) == 0; }
    bool endsWith(const String &text) const
    {
        return s_.size() >= text.s_.size() && s_.compare(s_.size() - text.s_.size(), text.s_.size(), text.s_) == 0;
    }
    bool equals(const String &text) const { return s_ == text.s_; }
    bool equalsIgnoreCase(const String &text) const
    {
        String a = *this, b = text;
        a.toLowerCase(), b.toLowerCase();
        return a.s_ == b.s_;
    }
    int compareTo(const String &text) const { return s_.compare(text.s_); }
    bool concat(const String &text) { return s_ += text.s_, true; }
    bool concat(char c) { return s_ += c, true; }
    void trim()
    {
        const char *blank = " \t\r\n\v\f";
        s_.erase(0, s_.find_first_not_of(blank));
        s_.erase(s_.find_last_not_of(blank) + 1);
    }
    void toLowerCase() { change('A', 'Z', 32); }
    void toUpperCase() { change('a', 'z', -32); }
    void remove(unsigned from, unsigned n = unsigned(-1))
    {
        if (from < s_.size())
            s_.erase(from, n);
    }
    void replace(const String &old, const String &by)
    {
        for (size_t k = 0; old.length() && (k = s_.find(old.s_, k)) != std::string::npos; k += by.s_.size())
            s_.replace(k, old.s_.size(), by.s_);
    }
    long toInt() const { return strtol(c_str(), nullptr, 10); }
    float toFloat() const { return strtof(c_str(), nullptr); }
    double toDouble() const { return strtod(c_str(), nullptr); }
    void toCharArray(char *to, unsigned n) const { snprintf(to, n, "%s", c_str()); }

    String &operator+=(const String &text) { return s_ += text.s_, *this; }
    String &operator+=(char c) { return s_ += c, *this; }
    template <typename Number> String &operator+=(Number v) { return *this += String(v); }
    friend String operator+(String a, const String &b) { return a += b; }
    friend String operator+(String a, char b) { return a += b; }
    template <typename Number> friend String operator+(String a, Number b) { return a += String(b); }
    bool operator==(const String &o) const { return s_ == o.s_; }
    bool operator!=(const String &o) const { return s_ != o.s_; }
    bool operator<(const String &o) const { return s_ < o.s_; }
    bool operator>(const String &o) const { return s_ > o.s_; }

  private:
    static int at(size_t k) { return k == std::string::npos ? -1 : int(k); }
    void change(char first, char last, int by)
    {
        for (char &c : s_)
            if (c >= first && c <= last)
                c = char(c + by);
    }
    std::string s_;
};

} /* extern "C++" */
#endif
