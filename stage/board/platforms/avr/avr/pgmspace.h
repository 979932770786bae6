/* avr/pgmspace.h on an emulated board: there is one memory. */
#ifndef PULSESTAGE_AVR_PGMSPACE_H
#define PULSESTAGE_AVR_PGMSPACE_H

#include <stdint.h>
#include <stdio.h>
#include <string.h>

#define PROGMEM
#define __flash
#define PGM_P const char *
#define PGM_VOID_P const void *
#define PSTR(text) (text)
#define pgm_read_byte(address) (*(const uint8_t *)(address))
#define pgm_read_byte_near(address) pgm_read_byte(address)
#define pgm_read_word(address) (*(const uint16_t *)(address))
#define pgm_read_word_near(address) pgm_read_word(address)
#define pgm_read_dword(address) (*(const uint32_t *)(address))
#define pgm_read_float(address) (*(const float *)(address))
#define pgm_read_ptr(address) (*(void *const *)(address))
#define memcpy_P memcpy
#define memcmp_P memcmp
#define strcpy_P strcpy
#define strncpy_P strncpy
#define strcmp_P strcmp
#define strncmp_P strncmp
#define strlen_P strlen
#define strcat_P strcat
#define strstr_P strstr
#define sprintf_P sprintf
#define snprintf_P snprintf
#define printf_P printf

#endif
