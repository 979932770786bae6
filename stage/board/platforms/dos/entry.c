/* entry.c: where a DOS program begins on an emulated board: its main, which ends by a return or by exit. */
#define PULSESTAGE_DOS_ENTRY
#include <pulsestage_dos.h>

#ifdef __cplusplus
extern "C"
#endif
int pulsestage_program(int argc, char **argv) __asm__("main") __attribute__((visibility("hidden")));

PULSESTAGE_MAIN
{
    static char name[] = "PROGRAM.EXE";
    static char *words[] = {name, 0};
    struct pulsestage_dos *dos = &pulsestage_dos_state;
    if (!setjmp(dos->out)) {
        const int code = pulsestage_program(1, words);
#ifdef PULSESTAGE_VOID_MAIN
        (void)code;
#else
        dos->code = code;
#endif
    }
    if (dos->columns)
        pulsestage_dos_text("\n");
    fflush(stdout);
    return dos->code;
}
