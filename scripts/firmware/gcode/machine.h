/* machine.h: the states of the machine, and what may change them at any time. */
#ifndef MACHINE_H
#define MACHINE_H

#include <stdbool.h>
#include <stdint.h>

enum alarm {
    NO_ALARM,
    ALARM_HARD_LIMIT = 1,   /* a limit switch came on; the position is lost */
    ALARM_RESET = 3,        /* a reset during a move; the position is lost */
    ALARM_STUCK_SWITCH = 8, /* homing: the switch stayed on when the axis pulled off */
    ALARM_NO_SWITCH = 9,    /* homing: no switch within the search distance */
};

bool machine_take_realtime_command(char byte); /* by the receiver: ?, !, ~ and reset; false for other bytes */
void machine_check_limits(void);               /* by the interrupt of the limit switches */
void machine_raise_alarm(enum alarm alarm);
bool machine_is_locked(void);                  /* by an alarm */
void machine_unlock(void);
void machine_set_homing(bool homing);

bool machine_wait(void);        /* let interrupts come; false: an alarm or a reset ended what the caller does */
bool machine_wait_for_rest(void);
void machine_run(void);         /* the main program; never returns */

#endif
