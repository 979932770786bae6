#define _GNU_SOURCE
#include <pulsestage.h>
#include <signal.h>
#include <sys/mman.h>
#include <time.h>
#include <ucontext.h>
#define N 200000
#define R (*(volatile uint16_t *)(uintptr_t)0x4002100c)
static double now(void){ struct timespec t; clock_gettime(CLOCK_MONOTONIC,&t); return t.tv_sec+t.tv_nsec*1e-9; }
static void skip(int s, siginfo_t *i, void *c){ (void)s;(void)i; ((ucontext_t*)c)->uc_mcontext.gregs[REG_RIP]+=3; }
static __attribute__((noinline)) void touch(volatile uint16_t *p){ __asm__ volatile("movzwl (%0),%%eax"::"r"(p):"eax"); }
PULSESTAGE_MAIN
{
    double t; unsigned s=0;
    t=now(); for(int k=0;k<N;k++) s+=ps_in16(0x30c); ps_logf("ports        %9.0f/s", N/(now()-t));
    t=now(); for(int k=0;k<N;k++) s+=R; ps_logf("poll         %9.0f/s", N/(now()-t));
    t=now(); for(int k=0;k<N;k++) R=(uint16_t)k; ps_logf("write        %9.0f/s", N/(now()-t));
    t=now(); for(int k=0;k<N;k++) ps_out16(0x30c,(uint16_t)k); ps_logf("write ports  %9.0f/s", N/(now()-t));
    t=now(); for(int k=0;k<N/4;k++) { s+=R; __asm__ volatile("cvtsi2sd %%eax,%%xmm0":::"xmm0"); } ps_logf("signal each  %9.0f/s", N/4/(now()-t));
    struct sigaction a={.sa_flags=SA_SIGINFO|SA_ONSTACK}, b; a.sa_sigaction=skip; sigaction(SIGSEGV,&a,&b);
    void *p=mmap(0,4096,PROT_NONE,MAP_PRIVATE|MAP_ANONYMOUS,-1,0);
    t=now(); for(int k=0;k<N/4;k++) touch(p); ps_logf("bare signals %9.0f/s", N/4/(now()-t));
    sigaction(SIGSEGV,&b,0);
    return s&1;
}
