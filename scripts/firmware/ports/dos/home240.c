/* HOME240.C: X of a card with three PCL-240K at 340h, IRQ 5, for a compiler of DOS. Origin return, then 4000 pulses.
   Nothing here knows of an emulated board. */
#include <conio.h>
#include <dos.h>
#include <stdio.h>
#include <stdlib.h>

#define CARD 0x340
#define WHO (CARD + 12) /* which chips pull the interrupt line, a bit each */
#define IRQ 5

#define STATUS CARD
#define ORG 0x02
#define OPERATING 0x40
#define INT_AT_STOP 0x20

static volatile int stopped;
static void interrupt (far *old)(void);

static void interrupt far at_stop(void)
{
    if (inportb(WHO) & 1) {
        outportb(CARD, 0x08); /* reset command: /INT is released */
        stopped = 1;
    }
    outportb(0x20, 0x20); /* end of interrupt */
}

static void hook(void)
{
    old = getvect(8 + IRQ);
    disable();
    setvect(8 + IRQ, at_stop);
    outportb(0x21, inportb(0x21) & ~(1 << IRQ));
    enable();
}

static void unhook(void)
{
    outportb(0x21, inportb(0x21) | 1 << IRQ);
    setvect(8 + IRQ, old);
}

static void load(int number, unsigned long value)
{
    outportb(CARD, 0x80 | number);
    outportb(CARD + 3, (unsigned char)(value >> 16));
    outportb(CARD + 2, (unsigned char)(value >> 8));
    outportb(CARD + 1, (unsigned char)value);
}

/* A start, and until its end, or Esc. */
static void run(int control, int start)
{
    stopped = 0;
    outportb(CARD, 0x40 | control);
    outportb(CARD, start | INT_AT_STOP);
    while (!stopped)
        if (kbhit() && getch() == 27) {
            outportb(CARD, 0x08);
            cputs("stopped by hand\r\n");
            unhook();
            exit(2);
        }
    delay(50);
}

void main(void)
{
    hook();
    outportb(CARD, 0x08);
    load(1, 50);   /* FL 1000 pps */
    load(2, 400);  /* FH1 8000 pps */
    load(4, 1500); /* ramps */
    load(5, 1500);
    load(6, 485);
    load(7, 30);
    run(0x0B, 0x15); /* origin return towards minus, slowed by SD, at FH1 */
    if (!(inportb(STATUS) & ORG)) {
        cputs("no origin\r\n");
        unhook();
        exit(1);
    }
    cprintf("origin after %ld ticks\r\n", (long)biostime(0, 0L));
    load(0, 4000);
    load(6, 485); /* the reset command cleared it */
    run(0x04, 0x15); /* preset, towards plus */
    cputs("done\r\n");
    unhook();
}
