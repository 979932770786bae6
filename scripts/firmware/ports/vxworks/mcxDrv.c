/* mcxDrv.c: VxWorks driver for one NOVA MCX304: its X axis is homed and moved by a task, which the end of a drive wakes by interrupt.
   Nothing here knows of an emulated board. */
#include <vxWorks.h>
#include <intLib.h>
#include <iv.h>
#include <logLib.h>
#include <semLib.h>
#include <sysLib.h>
#include <taskLib.h>

#define MCX_BASE 0x300
#define MCX_VECTOR 0x2A
#define WR(n) (MCX_BASE + 2 * (n))
#define X 0x0100

#define D_END 0x8000 /* WR1: interrupt at the end of a drive */
#define SP1_E 0x0008 /* WR1: STOP1, the home switch, stops */
#define RR3_D_END 0x0080

LOCAL SEM_ID driveEnd;

LOCAL void mcxInt(int arg)
{
    sysOutWord(WR(0), X | 0x0F);
    if (sysInWord(WR(3)) & RR3_D_END) /* the reading clears it */
        semGive(driveEnd);
    (void)arg;
}

LOCAL void mcxLoad(int code, long value)
{
    int lock = intLock();
    sysOutWord(WR(6), (USHORT)value);
    sysOutWord(WR(7), (USHORT)(value >> 16));
    sysOutWord(WR(0), X | code);
    intUnlock(lock);
}

LOCAL void mcxMode(int n, int value)
{
    int lock = intLock();
    sysOutWord(WR(0), X | 0x0F);
    sysOutWord(WR(n), value);
    intUnlock(lock);
}

LOCAL long mcxPosition(void)
{
    int lock = intLock();
    long value;
    sysOutWord(WR(0), X | 0x10);
    value = sysInWord(WR(6));
    value |= (long)(INT16)sysInWord(WR(7)) * 65536;
    intUnlock(lock);
    return value;
}

LOCAL STATUS mcxDrive(int code, int seconds)
{
    sysOutWord(WR(0), X | code);
    if (semTake(driveEnd, seconds * sysClkRateGet()) == ERROR) {
        sysOutWord(WR(0), X | 0x27); /* sudden stop */
        logMsg("drive %02x: timeout\n", code, 0, 0, 0, 0, 0);
        return ERROR;
    }
    taskDelay(sysClkRateGet() / 10);
    return OK;
}

LOCAL int mcxTask(int pulses)
{
    mcxMode(1, D_END | SP1_E);
    if (mcxDrive(0x23, 10) == ERROR) /* continuous, towards minus, until STOP1 */
        return ERROR;
    mcxLoad(0x09, 0); /* LP */
    logMsg("home at tick %d\n", (int)tickGet(), 0, 0, 0, 0, 0);
    mcxMode(1, D_END);
    mcxLoad(0x06, pulses);
    if (mcxDrive(0x20, 10) == ERROR)
        return ERROR;
    logMsg("at %d\n", (int)mcxPosition(), 0, 0, 0, 0, 0);
    return mcxPosition() == pulses ? OK : ERROR;
}

STATUS usrAppInit(void)
{
    driveEnd = semBCreate(SEM_Q_FIFO, SEM_EMPTY);
    sysOutWord(WR(0), 0x8000); /* reset */
    taskDelay(1);
    mcxLoad(0x00, 800000); /* multiple 10 */
    mcxLoad(0x02, 320);    /* acceleration 400000 pps/s */
    mcxLoad(0x04, 100);    /* SV 1000 pps */
    mcxLoad(0x05, 800);    /* V 8000 pps */
    if (intConnect(INUM_TO_IVEC(MCX_VECTOR), (VOIDFUNCPTR)mcxInt, 0) == ERROR)
        return ERROR;
    intEnable(MCX_VECTOR);
    return taskSpawn("tMcx", 100, 0, 4000, (FUNCPTR)mcxTask, 4000, 0, 0, 0, 0, 0, 0, 0, 0, 0) == ERROR ? ERROR : OK;
}
