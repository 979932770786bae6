/* Arduino's String of WString.h, compiled once for all sketches. */
#include <WString.h>
#include <string>

struct String::Text {
    std::string s;
};

namespace
{
std::string digits(unsigned long long value, int base)
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
std::string number(long long value, int base)
{
    if (base < 2 || base > 36)
        base = 10;
    if (value < 0 && base != 10)
        return digits(uint32_t(value), base);
    return value < 0 ? "-" + digits(0ull - (unsigned long long)value, base) : digits((unsigned long long)value, base);
}
std::string fraction(double value, int places)
{
    char text[400];
    snprintf(text, sizeof text, "%.*f", places < 0 ? 0 : places > 30 ? 30 : places, value);
    return text;
}
/* What a search returns, as a String's functions do. */
int position_of(size_t k) { return k == std::string::npos ? -1 : int(k); }
void change_letters(std::string &text, char first, char last, int by)
{
    for (char &c : text)
        if (c >= first && c <= last)
            c = char(c + by);
}
} // namespace

String::String(const char *text) : text_(new Text{text ? text : ""}) {}
String::String(const __FlashStringHelper *text) : text_(new Text{reinterpret_cast<const char *>(text)}) {}
String::String(const String &other) : text_(new Text(*other.text_)) {}
String::~String() { delete text_; }
String &String::operator=(const String &other)
{
    text_->s = other.text_->s;
    return *this;
}
String::String(char c) : text_(new Text{std::string(1, c)}) {}
String::String(unsigned char v, int base) : text_(new Text{number(v, base)}) {}
String::String(int v, int base) : text_(new Text{number(v, base)}) {}
String::String(unsigned v, int base) : text_(new Text{number(v, base)}) {}
String::String(long v, int base) : text_(new Text{number(v, base)}) {}
String::String(unsigned long v, int base) : text_(new Text{digits(v, base)}) {}
String::String(float v, int places) : text_(new Text{fraction(v, places)}) {}
String::String(double v, int places) : text_(new Text{fraction(v, places)}) {}

const char *String::c_str() const { return text_->s.c_str(); }
unsigned String::length() const { return unsigned(text_->s.size()); }
bool String::isEmpty() const { return text_->s.empty(); }
bool String::reserve(unsigned n) { return text_->s.reserve(n), true; }
char String::charAt(unsigned k) const { return k < text_->s.size() ? text_->s[k] : '\0'; }
char String::operator[](unsigned k) const { return charAt(k); }
char &String::operator[](unsigned k) { return text_->s[k]; }
void String::setCharAt(unsigned k, char c)
{
    if (k < text_->s.size())
        text_->s[k] = c;
}
int String::indexOf(char c, unsigned from) const { return position_of(text_->s.find(c, from)); }
int String::indexOf(const String &text, unsigned from) const { return position_of(text_->s.find(text.text_->s, from)); }
int String::lastIndexOf(char c) const { return position_of(text_->s.rfind(c)); }
String String::substring(unsigned from) const { return substring(from, length()); }
String String::substring(unsigned from, unsigned to) const
{
    if (from > to)
        std::swap(from, to);
    return from < text_->s.size() ? String(text_->s.substr(from, to - from).c_str()) : String();
}
bool String::startsWith(const String &text) const { return text_->s.compare(0, text.text_->s.size(), text.text_->s) == 0; }
bool String::endsWith(const String &text) const
{
    const std::string &all = text_->s, &end = text.text_->s;
    return all.size() >= end.size() && all.compare(all.size() - end.size(), end.size(), end) == 0;
}
bool String::equals(const String &text) const { return text_->s == text.text_->s; }
bool String::equalsIgnoreCase(const String &text) const
{
    String a = *this, b = text;
    a.toLowerCase(), b.toLowerCase();
    return a.text_->s == b.text_->s;
}
int String::compareTo(const String &text) const { return text_->s.compare(text.text_->s); }
bool String::concat(const String &text) { return text_->s += text.text_->s, true; }
bool String::concat(char c) { return text_->s += c, true; }
void String::trim()
{
    const char *blank = " \t\r\n\v\f";
    text_->s.erase(0, text_->s.find_first_not_of(blank));
    text_->s.erase(text_->s.find_last_not_of(blank) + 1);
}
void String::toLowerCase() { change_letters(text_->s, 'A', 'Z', 32); }
void String::toUpperCase() { change_letters(text_->s, 'a', 'z', -32); }
void String::remove(unsigned from, unsigned n)
{
    if (from < text_->s.size())
        text_->s.erase(from, n);
}
void String::replace(const String &old, const String &by)
{
    for (size_t k = 0; old.length() && (k = text_->s.find(old.text_->s, k)) != std::string::npos; k += by.text_->s.size())
        text_->s.replace(k, old.text_->s.size(), by.text_->s);
}
long String::toInt() const { return strtol(c_str(), nullptr, 10); }
float String::toFloat() const { return strtof(c_str(), nullptr); }
double String::toDouble() const { return strtod(c_str(), nullptr); }
void String::toCharArray(char *to, unsigned n) const { snprintf(to, n, "%s", c_str()); }

String &String::operator+=(const String &text) { return text_->s += text.text_->s, *this; }
String &String::operator+=(char c) { return text_->s += c, *this; }
bool String::operator==(const String &o) const { return text_->s == o.text_->s; }
bool String::operator!=(const String &o) const { return text_->s != o.text_->s; }
bool String::operator<(const String &o) const { return text_->s < o.text_->s; }
bool String::operator>(const String &o) const { return text_->s > o.text_->s; }
