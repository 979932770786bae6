/* worst.cpp: what firmware can do to whoever runs it, one of these at a time: WORST=exit stage run worst.cpp
 *
 * docs/firmware_trust.md says how each of them ends. */
#include <pulsestage.h>

#include <cstdlib>
#include <cstring>
#include <fenv.h>
#include <pthread.h>
#include <setjmp.h>
#include <signal.h>
#include <stdexcept>
#include <sys/ptrace.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

static volatile int nothing, zero;

static int deeper(int k)
{
    volatile char room[4096];
    room[0] = (char)k;
    return zero ? 0 : deeper(k + 1) + room[0];
}

static void hook(void *argument)
{
    ps_in8(0x300);
    nothing = deeper(argument != nullptr);
}

static void returns(int)
{
}

static void *reads(void *)
{
    for (;;)
        ps_in8(0x300);
}

static void *returns_null(void *)
{
    return nullptr;
}

static void *computes(void *)
{
    for (;;)
        zero = zero * 1;
}

static int does(const char *what)
{
    auto is = [what](const char *name) { return !std::strcmp(what, name); };
    if (is("exit"))
        std::exit(0);
    if (is("abort"))
        std::abort();
    if (is("pointer"))
        *reinterpret_cast<volatile int *>(0x40021000) = 1;
    if (is("stack"))
        return deeper(1);
    if (is("spin"))
        for (;;)
            nothing = nothing + 1;
    if (is("poll"))
        for (;;)
            ps_in8(0x300);
    if (is("throw"))
        throw std::runtime_error("nobody catches this");
    if (is("divide"))
        nothing = 5 / zero;
    if (is("traps")) {
        volatile double none = 0;
        feenableexcept(FE_ALL_EXCEPT);
        nothing = int(1 / none);
    }
    if (is("free")) {
        void *volatile room = std::malloc(100);
        std::free(room);
        std::free(room);
    }
    if (is("memory")) {
        rlimit most{4ULL << 30, 4ULL << 30}; /* as a machine that has no more */
        setrlimit(RLIMIT_AS, &most);
        for (;;)
            *static_cast<volatile char *>(std::malloc(64 << 20)) = 1;
    }
    if (is("log"))
        for (;;)
            ps_log("a line of a flood");
    if (is("hook")) {
        ps_on_interrupt(hook, nullptr); /* nothing interrupts here: it is called by hand */
        hook(nullptr);
    }
    if (is("bus")) {
        pulsestage_bus = nullptr;
        ps_in8(0x300);
    }
    if (is("garble"))
        memset(pulsestage_bus->host, 0xFF, 4096);
    if (is("threads")) {
        pthread_t other;
        pthread_create(&other, nullptr, reads, nullptr);
        reads(nullptr);
    }
    if (is("thread")) {
        pthread_t other;
        pthread_create(&other, nullptr, computes, nullptr);
    }
    if (is("leave"))
        pthread_exit(nullptr);
    if (is("sysexit"))
        syscall(SYS_exit, 0);
    if (is("fork")) {
        pid_t child = fork();
        ps_in8(0x301);
        if (!child)
            _exit(0);
        waitpid(child, nullptr, 0);
    }
    if (is("daemon") && !fork())
        for (;;)
            pause();
    if (is("child")) {
        pid_t child = fork();
        if (!child) {
            pthread_t other;
            usleep(1000);
            pthread_create(&other, nullptr, returns_null, nullptr);
            pthread_join(other, nullptr);
            exit(0);
        }
        int status = 0;
        waitpid(child, &status, 0);
        return status;
    }
    if (is("cut"))
        for (int k = 3; k < 1024; k++)
            if (ftruncate(k, 0) < 0)
                zero = 0;
    if (is("exec"))
        execl("/bin/true", "true", static_cast<char *>(nullptr));
    if (is("close")) {
        for (int k = 3; k < 1024; k++)
            close(k);
        ps_delay_us(100);
    }
    if (is("write"))
        for (int k = 3; k < 1024; k++)
            if (write(k, "0123456789", 10) < 0)
                zero = 0;
    if (is("stop"))
        raise(SIGSTOP);
    if (is("handlers")) {
        for (int k = 1; k < 32; k++)
            signal(k, returns);
        *reinterpret_cast<volatile int *>(0x40021000) = 1;
    }
    if (is("kill")) {
        kill(getppid(), SIGKILL);
        ps_delay_us(100);
        sleep(5);
    }
    if (is("halt"))
        kill(getppid(), SIGSTOP);
    if (is("trace"))
        ptrace(PTRACE_ATTACH, getppid(), nullptr, nullptr);
    if (is("longjmp")) {
        static jmp_buf never;
        longjmp(never, 1);
    }
    return 0;
}

PULSESTAGE_MAIN
{
    const char *what = std::getenv("WORST");
    ps_in8(0x304);
    return does(what ? what : "");
}
