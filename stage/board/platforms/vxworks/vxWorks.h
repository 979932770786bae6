/* vxWorks.h on an emulated board: VxWorks as far as one thread goes. sysLib.h, taskLib.h, semLib.h, intLib.h, iv.h, logLib.h, msgQLib.h,
 * tickLib.h, wdLib.h lead here.
 *
 * Port functions are cycles of the board; a tick is 1/60 s of simulated time, or what sysClkRateSet says. A routine of intConnect is called
 * while the board's interrupt line is asserted, whatever its vector; it may give semaphores and send messages. Blocking functions let
 * time pass, in which interrupts come, until they have what they wait for. A task of taskSpawn runs when usrAppInit has returned, each to
 * its end, the most urgent first: two tasks that wait for each other need the system itself. C99, C++11. */
#ifndef PULSESTAGE_VXWORKS_H
#define PULSESTAGE_VXWORKS_H

#include <errno.h>
#include <pulsestage.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifdef __cplusplus
extern "C" {
#endif

#define VX_FUNCTION static __attribute__((unused))

typedef int STATUS;
typedef int BOOL;
typedef int8_t INT8;
typedef int16_t INT16;
typedef int32_t INT32;
typedef int64_t INT64;
typedef uint8_t UINT8;
typedef uint16_t UINT16;
typedef uint32_t UINT32;
typedef uint64_t UINT64;
typedef unsigned char UCHAR;
typedef unsigned short USHORT;
typedef unsigned int UINT;
typedef unsigned long ULONG;
typedef unsigned char UBYTE;
typedef unsigned short UWORD;
typedef int ARGINT;
typedef intptr_t _Vx_usr_arg_t;
typedef intptr_t _Vx_ticks_t;
#ifdef __cplusplus
typedef int (*FUNCPTR)(...);
typedef void (*VOIDFUNCPTR)(...);
#else
typedef int (*FUNCPTR)();
typedef void (*VOIDFUNCPTR)();
#endif

#define OK 0
#define ERROR (-1)
#ifndef TRUE
#define TRUE 1
#define FALSE 0
#endif
#define LOCAL static
#define IMPORT extern
#define FAST register
#define EOS '\0'
#define NONE (-1)
#define FOREVER for (;;)
#define NELEMENTS(array) (sizeof(array) / sizeof((array)[0]))
#define WAIT_FOREVER (-1)
#define NO_WAIT 0
#ifdef __cplusplus
#undef FAST
#define FAST
#endif
#ifndef max
#ifndef __cplusplus
#define max(a, b) ((a) > (b) ? (a) : (b))
#define min(a, b) ((a) < (b) ? (a) : (b))
#endif
#endif

enum { S_objLib_OBJ_UNAVAILABLE = 0x3D0002, S_objLib_OBJ_TIMEOUT = 0x3D0004, S_objLib_OBJ_ID_ERROR = 0x3D0001 };

typedef void (*pulsestage_vx_call)(intptr_t argument);

struct pulsestage_vx_task {
    char name[32];
    int priority, taken;
    void (*entry)(void);
    intptr_t arguments[10];
};

/* one for all sources */
struct pulsestage_vx {
    int rate, hooked, self, n_tasks;
    struct {
        int vector;
        void (*routine)(void);
        intptr_t argument;
    } connected[16];
    int n_connected;
    uint64_t tick_zero;
    struct pulsestage_vx_task tasks[32];
    struct pulsestage_vx_watchdog *watchdogs;
};
PULSESTAGE_SHARED struct pulsestage_vx pulsestage_vx_state;

/* ports: sysLib */
VX_FUNCTION UCHAR sysInByte(ULONG port) { return ps_in8((uint32_t)port); }
VX_FUNCTION USHORT sysInWord(ULONG port) { return ps_in16((uint32_t)port); }
VX_FUNCTION ULONG sysInLong(ULONG port)
{
    const ULONG low = ps_in16((uint32_t)port);
    return low | (ULONG)ps_in16((uint32_t)port + 2) << 16;
}
VX_FUNCTION void sysOutByte(ULONG port, UCHAR value) { ps_out8((uint32_t)port, value); }
VX_FUNCTION void sysOutWord(ULONG port, USHORT value) { ps_out16((uint32_t)port, value); }
VX_FUNCTION void sysOutLong(ULONG port, ULONG value)
{
    ps_out16((uint32_t)port, (uint16_t)value);
    ps_out16((uint32_t)port + 2, (uint16_t)(value >> 16));
}

/* time */
VX_FUNCTION int sysClkRateGet(void) { return pulsestage_vx_state.rate ? pulsestage_vx_state.rate : 60; }
VX_FUNCTION STATUS sysClkRateSet(int rate)
{
    if (rate < 1 || rate > 100000)
        return ERROR;
    pulsestage_vx_state.rate = rate;
    return OK;
}
VX_FUNCTION ULONG tickGet(void) { return (ULONG)(ps_micros() * (uint64_t)sysClkRateGet() / 1000000u); }
VX_FUNCTION uint64_t pulsestage_vx_after(uint64_t now, uint64_t ticks) /* us: the tick after so many */
{
    const uint64_t rate = (uint64_t)sysClkRateGet();
    return ((now * rate / 1000000u + ticks) * 1000000u + rate - 1) / rate;
}
VX_FUNCTION void pulsestage_vx_ticks(uint64_t ticks) /* up to the tick after so many */
{
    const uint64_t now = ps_micros();
    uint64_t left = pulsestage_vx_after(now, ticks);
    for (left = left > now ? left - now : 0; left; left -= left > 1000000000u ? 1000000000u : left)
        ps_delay_us((uint32_t)(left > 1000000000u ? 1000000000u : left));
}
VX_FUNCTION STATUS taskDelay(_Vx_ticks_t ticks) { return pulsestage_vx_ticks(ticks > 0 ? (uint64_t)ticks : 0), OK; }
VX_FUNCTION void sysUsDelay(int us) { ps_delay_us((uint32_t)us); }
VX_FUNCTION UINT32 sysTimestamp(void) { return (UINT32)ps_micros(); }
VX_FUNCTION UINT32 sysTimestampFreq(void) { return 1000000; }
VX_FUNCTION STATUS sysTimestampEnable(void) { return OK; }
/* Waits, a tick at a time, until `ready(what)`. */
VX_FUNCTION STATUS pulsestage_vx_wait(int (*ready)(void *), void *what, int ticks)
{
    while (!ready(what)) {
        if (ticks == NO_WAIT) {
            errno = S_objLib_OBJ_UNAVAILABLE;
            return ERROR;
        }
        pulsestage_vx_ticks(1);
        if (ticks != WAIT_FOREVER && --ticks == 0 && !ready(what)) {
            errno = S_objLib_OBJ_TIMEOUT;
            return ERROR;
        }
    }
    return OK;
}
#define errnoGet() (errno)
#define errnoSet(value) (errno = (value))

/* the log: logLib */
VX_FUNCTION int logMsg(const char *format, _Vx_usr_arg_t a1, _Vx_usr_arg_t a2, _Vx_usr_arg_t a3, _Vx_usr_arg_t a4, _Vx_usr_arg_t a5,
                       _Vx_usr_arg_t a6)
{
    char text[512];
    int n = snprintf(text, sizeof text, format, a1, a2, a3, a4, a5, a6);
    while (n > 0 && (size_t)n < sizeof text && (text[n - 1] == '\n' || text[n - 1] == '\r'))
        text[--n] = 0;
    ps_log(text);
    return n;
}

/* interrupts: intLib, iv */
#define INUM_TO_IVEC(number) ((VOIDFUNCPTR *)(intptr_t)(number))
#define IVEC_TO_INUM(vector) ((int)(intptr_t)(vector))
#define INT_NUM_IRQ0 0x20
#define INT_NUM_GET(irq) (INT_NUM_IRQ0 + (irq))
VX_FUNCTION void pulsestage_vx_called(void *unused)
{
    struct pulsestage_vx *vx = &pulsestage_vx_state;
    int k;
    (void)unused;
    for (k = 0; k < vx->n_connected; k++)
        ((pulsestage_vx_call)vx->connected[k].routine)(vx->connected[k].argument);
}
VX_FUNCTION void pulsestage_vx_update(void)
{
    struct pulsestage_vx *vx = &pulsestage_vx_state;
    const int wanted = vx->n_connected != 0;
    if (wanted != vx->hooked) {
        vx->hooked = wanted;
        ps_on_interrupt(wanted ? pulsestage_vx_called : 0, 0);
    }
}
VX_FUNCTION STATUS pulsestage_vx_connect(VOIDFUNCPTR *vector, void (*routine)(void), intptr_t argument)
{
    struct pulsestage_vx *vx = &pulsestage_vx_state;
    if (vx->n_connected == (int)NELEMENTS(vx->connected))
        return ERROR;
    vx->connected[vx->n_connected].vector = IVEC_TO_INUM(vector);
    vx->connected[vx->n_connected].routine = routine;
    vx->connected[vx->n_connected++].argument = argument;
    pulsestage_vx_update();
    return OK;
}
#define intConnect(vector, routine, argument)                                                                          \
    pulsestage_vx_connect((vector), (void (*)(void))(routine), (intptr_t)(argument))
VX_FUNCTION STATUS intDisconnect(VOIDFUNCPTR *vector, VOIDFUNCPTR routine, intptr_t argument)
{
    struct pulsestage_vx *vx = &pulsestage_vx_state;
    int k, n = 0;
    (void)routine, (void)argument;
    for (k = 0; k < vx->n_connected; k++)
        if (vx->connected[k].vector != IVEC_TO_INUM(vector))
            vx->connected[n++] = vx->connected[k];
    vx->n_connected = n;
    pulsestage_vx_update();
    return OK;
}
VX_FUNCTION int intLock(void) { return ps_disable(); }
VX_FUNCTION void intUnlock(int was) { ps_enable(was & PS_HIGHEST); }
VX_FUNCTION STATUS intEnable(int level) { return (void)level, OK; }
VX_FUNCTION STATUS intDisable(int level) { return (void)level, OK; }
VX_FUNCTION STATUS sysIntEnable(int level) { return (void)level, OK; } /* of a VMEbus */
VX_FUNCTION STATUS sysIntDisable(int level) { return (void)level, OK; }
VX_FUNCTION STATUS sysIntEnablePIC(int irq) { return (void)irq, OK; }
VX_FUNCTION STATUS sysIntDisablePIC(int irq) { return (void)irq, OK; }

/* watchdogs: wdLib. One timer of the board is set to the next of them; its routine is called at interrupt level. */
#define PULSESTAGE_VX_TIMER 7
typedef struct pulsestage_vx_watchdog {
    uint64_t due; /* us; 0: it is not started */
    void (*routine)(void);
    intptr_t argument;
    struct pulsestage_vx_watchdog *next;
} * WDOG_ID;
VX_FUNCTION void pulsestage_vx_barked(void *unused);
VX_FUNCTION void pulsestage_vx_arm(void)
{
    const struct pulsestage_vx_watchdog *w;
    const uint64_t now = ps_micros();
    uint64_t next = 0;
    for (w = pulsestage_vx_state.watchdogs; w; w = w->next)
        if (w->due && (!next || w->due < next))
            next = w->due;
    ps_timer(PULSESTAGE_VX_TIMER, 1, next ? (next > now ? (next - now) * 1000u : 1) : 0, next ? pulsestage_vx_barked : 0, 0);
}
VX_FUNCTION void pulsestage_vx_barked(void *unused)
{
    const uint64_t now = ps_micros();
    struct pulsestage_vx_watchdog *w;
    (void)unused;
    for (w = pulsestage_vx_state.watchdogs; w; w = w->next)
        if (w->due && w->due <= now) {
            w->due = 0;
            ((pulsestage_vx_call)w->routine)(w->argument);
        }
    pulsestage_vx_arm();
}
VX_FUNCTION WDOG_ID wdCreate(void)
{
    WDOG_ID made = (WDOG_ID)calloc(1, sizeof *made);
    if (made) {
        made->next = pulsestage_vx_state.watchdogs;
        pulsestage_vx_state.watchdogs = made;
    }
    return made;
}
VX_FUNCTION STATUS pulsestage_vx_start(WDOG_ID w, int ticks, void (*routine)(void), intptr_t argument)
{
    if (!w || !routine)
        return ERROR;
    w->due = pulsestage_vx_after(ps_micros(), ticks > 0 ? (uint64_t)ticks : 1);
    w->routine = routine;
    w->argument = argument;
    pulsestage_vx_arm();
    return OK;
}
#define wdStart(watchdog, ticks, routine, argument)                                                                    \
    pulsestage_vx_start((watchdog), (int)(ticks), (void (*)(void))(routine), (intptr_t)(argument))
VX_FUNCTION STATUS wdCancel(WDOG_ID w)
{
    if (!w)
        return ERROR;
    w->due = 0;
    pulsestage_vx_arm();
    return OK;
}
VX_FUNCTION STATUS wdDelete(WDOG_ID w) { return wdCancel(w); }

/* semaphores: semLib */
typedef struct pulsestage_vx_semaphore {
    int count, most;
} * SEM_ID;
typedef enum { SEM_EMPTY, SEM_FULL } SEM_B_STATE;
#define SEM_Q_FIFO 0x00
#define SEM_Q_PRIORITY 0x01
#define SEM_DELETE_SAFE 0x04
#define SEM_INVERSION_SAFE 0x08
VX_FUNCTION SEM_ID pulsestage_vx_semaphore(int count, int most)
{
    SEM_ID made = (SEM_ID)malloc(sizeof *made);
    if (made) {
        made->count = count;
        made->most = most;
    }
    return made;
}
VX_FUNCTION SEM_ID semBCreate(int options, SEM_B_STATE state) { return (void)options, pulsestage_vx_semaphore((int)state, 1); }
VX_FUNCTION SEM_ID semCCreate(int options, int count) { return (void)options, pulsestage_vx_semaphore(count, 0x7FFFFFFF); }
VX_FUNCTION SEM_ID semMCreate(int options) /* one thread holds it as often as it likes */
{
    (void)options;
    return pulsestage_vx_semaphore(0x3FFFFFFF, 0x7FFFFFFF);
}
VX_FUNCTION STATUS semGive(SEM_ID s) { return s ? (s->count += s->count < s->most, OK) : ERROR; }
VX_FUNCTION STATUS semFlush(SEM_ID s) { return semGive(s); }
VX_FUNCTION int pulsestage_vx_given(void *s) { return *(volatile int *)&((SEM_ID)s)->count > 0; }
VX_FUNCTION STATUS semTake(SEM_ID s, int ticks)
{
    if (!s || pulsestage_vx_wait(pulsestage_vx_given, s, ticks) != OK)
        return ERROR;
    s->count--;
    return OK;
}
VX_FUNCTION STATUS semDelete(SEM_ID s) { return free(s), OK; }

/* messages: msgQLib */
typedef struct pulsestage_vx_queue {
    int most, length, first, n;
    int *lengths;
    char *bytes;
} * MSG_Q_ID;
#define MSG_Q_FIFO 0x00
#define MSG_Q_PRIORITY 0x01
#define MSG_PRI_NORMAL 0
#define MSG_PRI_URGENT 1
VX_FUNCTION MSG_Q_ID msgQCreate(int most, int length, int options)
{
    MSG_Q_ID q = (MSG_Q_ID)calloc(1, sizeof *q);
    (void)options;
    if (q) {
        q->most = most;
        q->length = length;
        q->lengths = (int *)calloc((size_t)most, sizeof(int));
        q->bytes = (char *)calloc((size_t)most, (size_t)length);
    }
    return q;
}
VX_FUNCTION int pulsestage_vx_room(void *q) { return ((volatile struct pulsestage_vx_queue *)q)->n < ((MSG_Q_ID)q)->most; }
VX_FUNCTION int pulsestage_vx_filled(void *q) { return ((volatile struct pulsestage_vx_queue *)q)->n > 0; }
VX_FUNCTION STATUS msgQSend(MSG_Q_ID q, char *message, UINT bytes, int ticks, int priority)
{
    int at;
    if (bytes > (UINT)q->length || pulsestage_vx_wait(pulsestage_vx_room, q, ticks) != OK)
        return ERROR;
    if (priority == MSG_PRI_URGENT)
        q->first = (q->first + q->most - 1) % q->most;
    at = priority == MSG_PRI_URGENT ? q->first : (q->first + q->n) % q->most;
    memcpy(q->bytes + (size_t)at * (size_t)q->length, message, bytes);
    q->lengths[at] = (int)bytes;
    q->n++;
    return OK;
}
VX_FUNCTION int msgQReceive(MSG_Q_ID q, char *buffer, UINT room, int ticks)
{
    int bytes;
    if (pulsestage_vx_wait(pulsestage_vx_filled, q, ticks) != OK)
        return ERROR;
    bytes = q->lengths[q->first] < (int)room ? q->lengths[q->first] : (int)room;
    memcpy(buffer, q->bytes + (size_t)q->first * (size_t)q->length, (size_t)bytes);
    q->first = (q->first + 1) % q->most;
    q->n--;
    return bytes;
}
VX_FUNCTION int msgQNumMsgs(MSG_Q_ID q) { return q->n; }

/* tasks: taskLib */
typedef int TASK_ID;
#define VX_FP_TASK 0x0008
VX_FUNCTION int pulsestage_vx_spawn(const char *name, int priority, void (*entry)(void), const intptr_t *arguments)
{
    struct pulsestage_vx *vx = &pulsestage_vx_state;
    struct pulsestage_vx_task *task = &vx->tasks[vx->n_tasks];
    if (vx->n_tasks == (int)NELEMENTS(vx->tasks))
        return ERROR;
    snprintf(task->name, sizeof task->name, "%s", name ? name : "task");
    task->priority = priority;
    task->entry = entry;
    memcpy(task->arguments, arguments, sizeof task->arguments);
    return ++vx->n_tasks;
}
VX_FUNCTION int taskSpawn(const char *name, int priority, int options, int stack, FUNCPTR entry, _Vx_usr_arg_t a1, _Vx_usr_arg_t a2,
                          _Vx_usr_arg_t a3, _Vx_usr_arg_t a4, _Vx_usr_arg_t a5, _Vx_usr_arg_t a6, _Vx_usr_arg_t a7,
                          _Vx_usr_arg_t a8, _Vx_usr_arg_t a9, _Vx_usr_arg_t a10)
{
    intptr_t given[10];
    (void)options, (void)stack;
    given[0] = a1, given[1] = a2, given[2] = a3, given[3] = a4, given[4] = a5;
    given[5] = a6, given[6] = a7, given[7] = a8, given[8] = a9, given[9] = a10;
    return pulsestage_vx_spawn(name, priority, (void (*)(void))entry, given);
}
VX_FUNCTION int taskIdSelf(void) { return pulsestage_vx_state.self; }
VX_FUNCTION STATUS taskLock(void) { return OK; }
VX_FUNCTION STATUS taskUnlock(void) { return OK; }
VX_FUNCTION STATUS taskSafe(void) { return OK; }
VX_FUNCTION STATUS taskUnsafe(void) { return OK; }
VX_FUNCTION STATUS taskPrioritySet(int task, int priority) { return (void)task, (void)priority, OK; }

#ifdef __cplusplus
}
#endif

#endif
