/* WString.h on an emulated board: Arduino's String, whose functions are in WString.cpp. */
#ifndef PULSESTAGE_WSTRING_H
#define PULSESTAGE_WSTRING_H

#ifndef __cplusplus
#error "WString.h is C++ here: build with --platform"
#endif

extern "C++" { /* also where a program in C is included */

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

class __FlashStringHelper;
#define F(text) (reinterpret_cast<const __FlashStringHelper *>(text))

class String
{
  public:
    String(const char *text = "");
    String(const __FlashStringHelper *text);
    String(const String &other);
    explicit String(char c);
    explicit String(unsigned char v, int base = 10);
    explicit String(int v, int base = 10);
    explicit String(unsigned v, int base = 10);
    explicit String(long v, int base = 10);
    explicit String(unsigned long v, int base = 10);
    explicit String(float v, int places = 2);
    explicit String(double v, int places = 2);
    ~String();
    String &operator=(const String &other);

    const char *c_str() const;
    unsigned length() const;
    bool isEmpty() const;
    bool reserve(unsigned n);
    char charAt(unsigned k) const;
    char operator[](unsigned k) const;
    char &operator[](unsigned k);
    void setCharAt(unsigned k, char c);
    int indexOf(char c, unsigned from = 0) const;
    int indexOf(const String &text, unsigned from = 0) const;
    int lastIndexOf(char c) const;
    String substring(unsigned from) const;
    String substring(unsigned from, unsigned to) const;
    bool startsWith(const String &text) const;
    bool endsWith(const String &text) const;
    bool equals(const String &text) const;
    bool equalsIgnoreCase(const String &text) const;
    int compareTo(const String &text) const;
    bool concat(const String &text);
    bool concat(char c);
    void trim();
    void toLowerCase();
    void toUpperCase();
    void remove(unsigned from, unsigned n = unsigned(-1));
    void replace(const String &old, const String &by);
    long toInt() const;
    float toFloat() const;
    double toDouble() const;
    void toCharArray(char *to, unsigned n) const;

    String &operator+=(const String &text);
    String &operator+=(char c);
    template <typename Number> String &operator+=(Number v) { return *this += String(v); }
    friend String operator+(String a, const String &b) { return a += b; }
    friend String operator+(String a, char b) { return a += b; }
    template <typename Number> friend String operator+(String a, Number b) { return a += String(b); }
    bool operator==(const String &o) const;
    bool operator!=(const String &o) const;
    bool operator<(const String &o) const;
    bool operator>(const String &o) const;

  private:
    struct Text; /* a std::string, whose header takes long to compile */
    Text *text_;
};

} /* extern "C++" */
#endif
