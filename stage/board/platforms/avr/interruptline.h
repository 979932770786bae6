/* interruptline.h: the board's interrupt line at a microcontroller's interrupt input, by level or by edge.
 *
 * By level the routine is called again and again while the line is asserted. By edge it is called once; then again after the line
 * was released and asserted anew. The release is looked for after cycles of a PinBus and in delays, one bus cycle a look. */
#ifndef PULSESTAGE_INTERRUPTLINE_H
#define PULSESTAGE_INTERRUPTLINE_H

#ifndef __cplusplus
#error "interruptline.h is C++ here: build with --platform"
#endif

extern "C++" { /* also where a program in C is included */

#include <pulsestage.h>

namespace pulsestage
{
struct InterruptLine {
    void (*routine)(void); /* 0: none */
    bool enabled;          /* the processor takes interrupts */
    bool edge, used;       /* by edge; and the line has been asserted since its last release */
    bool hooked, inside;
    void (*after)(void);   /* called when a routine has returned; 0: nothing */

    void attach(void (*new_routine)(void), bool by_edge)
    {
        routine = new_routine;
        edge = by_edge;
        used = routine && edge && ps_interrupt_line(); /* it has no edge before it */
        update();
    }
    void enable(bool on)
    {
        enabled = on;
        update();
    }
    void look()
    {
        if (used && routine && !ps_interrupt_line()) {
            used = false;
            update();
        }
    }
    void update()
    {
        const bool wanted = routine && (enabled || inside) && !used;
        if (wanted != hooked) {
            hooked = wanted;
            ps_on_interrupt(wanted ? called : nullptr, this);
        }
    }
    static void called(void *argument)
    {
        InterruptLine &line = *static_cast<InterruptLine *>(argument);
        const bool was = line.enabled;
        line.inside = true;
        line.used = line.edge;
        line.enabled = false;
        line.routine();
        line.enabled = was;
        line.inside = false;
        line.update();
        if (line.after)
            line.after();
    }
};

inline __attribute__((visibility("hidden"))) InterruptLine &interrupt_line()
{
    static InterruptLine one;
    return one;
}
} // namespace pulsestage

} /* extern "C++" */
#endif
