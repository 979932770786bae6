/* windows.c: how fast accesses to memory-mapped registers are, beside port cycles and beside bare signals.
 *
 *     stage run windows.c --chips MCX304 --map 0x40021000=0x300+0x20
 */
#define _GNU_SOURCE
#include <pulsestage.h>
#include <signal.h>
#include <sys/mman.h>
#include <time.h>
#include <ucontext.h>

#define N 200000
#define RR6 (*(volatile uint16_t *)(uintptr_t)0x4002100c)
#define PORT 0x30c

static double seconds(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + (double)t.tv_nsec * 1e-9;
}

#define MEASURE(name, times, what) \
    do { \
        double begin = seconds(); \
        for (int k = 0; k < (times); k++) \
            what; \
        ps_logf("%-40s %9.0f a second", name, (times) / (seconds() - begin)); \
    } while (0)

/* the access below is an instruction of 3 bytes */
static void skip(int number, siginfo_t *info, void *context)
{
    (void)number, (void)info;
    ((ucontext_t *)context)->uc_mcontext.gregs[REG_RIP] += 3;
}

PULSESTAGE_MAIN
{
    unsigned sum = 0;
    struct sigaction ours = {.sa_flags = SA_SIGINFO | SA_ONSTACK}, before;
    void *page = mmap(0, 4096, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);

    MEASURE("port reads", N, sum += ps_in16(PORT));
    MEASURE("window reads", N, sum += RR6);
    MEASURE("port writes", N, ps_out16(PORT, (uint16_t)k));
    MEASURE("window writes", N, RR6 = (uint16_t)k);
    MEASURE("window reads, a signal each", N / 4, {
        sum += RR6;
        __asm__ volatile("cvtsi2sd %%eax, %%xmm0" ::: "xmm0"); /* nothing that the handler does */
    });
    ours.sa_sigaction = skip;
    sigaction(SIGSEGV, &ours, &before);
    MEASURE("signals alone", N / 4, __asm__ volatile("movzwl (%0), %%eax" ::"a"(page)));
    sigaction(SIGSEGV, &before, 0);
    return sum == 1;
}
