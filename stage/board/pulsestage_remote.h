/* pulsestage_remote.h: the requests of pulsestage.h over TCP, to a stage that `stage serve` serves. POSIX.
 *
 *     cc -DPULSESTAGE_REMOTE -I"$(stage include)" driver.c -o driver && ./driver 127.0.0.1:7240
 *
 * Without an argument $PULSESTAGE_SERVER says where, and without that it is 127.0.0.1:7240. Writes and delays go together with the
 * next request that has an answer, unless an interrupt hook is set. The frames are those of docs/serve.md.
 */
#ifndef PULSESTAGE_REMOTE_H
#define PULSESTAGE_REMOTE_H

enum { PS_F_HELLO = 1, PS_F_BATCH, PS_F_LOG, PS_F_HOOK, PS_F_RETURN, PS_F_TIMER = 13, PS_F_INTERRUPT = 254, PS_F_ERROR = 255 };
enum { PS_UNTIL8 = 100, PS_UNTIL16, PS_UNTIL_LINE, PS_F_VERSION = 1, PS_F_HEAD = 12, PS_F_ENTRY = 32, PS_F_MOST = 1000, PS_F_TIMERS = 4 };

#if defined(MSG_NOSIGNAL) /* a server that is gone is told in words, and does not end the program by SIGPIPE */
#define PS_F_NO_SIGNAL MSG_NOSIGNAL
#else
#define PS_F_NO_SIGNAL 0
#endif

struct ps_remote {
    int wire, open, posted; /* entries that have not been sent */
    uint32_t number;
    const char *address;
    struct {
        void (*hook)(void *argument);
        void *argument;
    } hooks[1 + PS_F_TIMERS]; /* of the interrupt line, and of each timer */
    unsigned char frame[PS_F_HEAD + PS_F_MOST * PS_F_ENTRY];
};
extern struct ps_remote ps_remote; /* one for all files of a program */
PULSESTAGE_SHARED struct ps_remote ps_remote = {0, 0, 0, 0, 0, {{0, 0}}, {0}};

static inline void ps_fail(const char *text)
{
    fflush(stdout);
    fprintf(stderr, "pulsestage: %s\n", text);
    _Exit(2);
}
static inline void ps_put(unsigned char *to, uint64_t value, int bytes)
{
    for (; bytes--; value >>= 8)
        *to++ = (unsigned char)(value & 0xFF);
}
static inline uint64_t ps_get(const unsigned char *from, int bytes)
{
    uint64_t value = 0;
    while (bytes--)
        value = value << 8 | from[bytes];
    return value;
}
static inline void ps_send(uint32_t kind, size_t body) /* what is in ps_remote.frame, behind the head */
{
    unsigned char *from = ps_remote.frame, *end = from + PS_F_HEAD + body;
    ps_put(from, body, 4), ps_put(from + 4, kind, 4), ps_put(from + 8, ++ps_remote.number, 4);
    while (from < end) {
        long sent = (long)send(ps_remote.wire, from, (size_t)(end - from), PS_F_NO_SIGNAL);
        if (sent <= 0)
            ps_fail("the server is gone.");
        from += sent;
    }
}
static inline void ps_take(unsigned char *to, size_t bytes)
{
    while (bytes) {
        long came = (long)recv(ps_remote.wire, to, bytes, 0);
        if (came <= 0)
            ps_fail("the server has closed the connection.");
        to += came, bytes -= (size_t)came;
    }
}
/* Sends a frame and waits for its reply, the last 8 bytes of which are the answer; the hook is called meanwhile if need be. */
static inline int64_t ps_ask(uint32_t kind, size_t body)
{
    unsigned char head[PS_F_HEAD], text[1025] = {0}, last[8] = {0};
    ps_send(kind, body);
    for (;;) {
        ps_take(head, sizeof head);
        size_t length = (size_t)ps_get(head, 4), part;
        uint32_t said = (uint32_t)ps_get(head + 4, 4);
        if (said == PS_F_ERROR) {
            for (ps_take(head, 4), length -= 4, part = (size_t)ps_get(head, 4); part--; length -= 8)
                ps_take(last, 8);
            ps_take(text, length < 1024 ? length : 1024);
            ps_fail((const char *)text);
        }
        for (; length; length -= part) {
            part = length > 8 ? (length - 8 < 1024 ? length - 8 : 1024) : length;
            ps_take(length > 8 ? text : last, part);
        }
        if (said != PS_F_INTERRUPT)
            return (int64_t)ps_get(last, 8);
        part = (size_t)ps_get(last, 4); /* whose */
        if (part <= PS_F_TIMERS && ps_remote.hooks[part].hook)
            ps_remote.hooks[part].hook(ps_remote.hooks[part].argument);
        ps_send(PS_F_RETURN, 0);
    }
}
/* What waits goes out now; the answer is that of the last entry. */
static inline int64_t ps_flush(void)
{
    size_t body = (size_t)ps_remote.posted * PS_F_ENTRY;
    ps_remote.posted = 0;
    return body ? ps_ask(PS_F_BATCH, body) : 0;
}
static inline void ps_at_exit(void) { ps_flush(); }

static inline void ps_connect(void)
{
    const char *given = ps_remote.address ? ps_remote.address : getenv("PULSESTAGE_SERVER");
    char host[64] = "127.0.0.1", text[256];
    const char *colon = given ? strrchr(given, ':') : 0;
    size_t n = given ? (colon ? (size_t)(colon - given) : strlen(given)) : 0;
    struct sockaddr_in to;
    int on = 1;
    memset(&to, 0, sizeof to);
    to.sin_family = AF_INET, to.sin_port = htons((uint16_t)(colon ? atoi(colon + 1) : 7240));
    if (n && n < sizeof host)
        memcpy(host, given, n), host[n] = 0;
    ps_remote.open = 1, ps_remote.wire = socket(AF_INET, SOCK_STREAM, 0);
    if (n >= sizeof host || inet_pton(AF_INET, host, &to.sin_addr) != 1 ||
        connect(ps_remote.wire, (struct sockaddr *)&to, sizeof to)) {
        snprintf(text, sizeof text, "no server at %.80s. Start one: stage serve; its address is NUMBERS:PORT, as 127.0.0.1:7240.",
                 given ? given : "127.0.0.1:7240");
        ps_fail(text);
    }
    setsockopt(ps_remote.wire, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
    memcpy(ps_remote.frame + PS_F_HEAD, "PULSESTG", 8);
    ps_put(ps_remote.frame + PS_F_HEAD + 8, PS_F_VERSION, 4), ps_put(ps_remote.frame + PS_F_HEAD + 12, 0, 4);
    ps_ask(PS_F_HELLO, 16);
    atexit(ps_at_exit);
}
static inline int64_t ps_entry(int32_t what, uint32_t times, uint32_t every, uint32_t mask, int64_t a, int64_t b)
{
    unsigned char *to = ps_remote.frame + PS_F_HEAD + ps_remote.posted * PS_F_ENTRY;
    if (!ps_remote.open) {
        ps_connect();
        to = ps_remote.frame + PS_F_HEAD;
    }
    ps_put(to, (uint32_t)what, 4), ps_put(to + 4, times, 4), ps_put(to + 8, every, 4), ps_put(to + 12, mask, 4);
    ps_put(to + 16, (uint64_t)a, 8), ps_put(to + 24, (uint64_t)b, 8);
    ps_remote.posted++;
    for (int k = 0; k <= PS_F_TIMERS; k++)
        if (ps_remote.hooks[k].hook)
            return ps_flush();
    if ((what == PS_OUT8 || what == PS_OUT16 || what == PS_OUT32 || what == PS_DELAY || what == PS_SPEND || what == PS_SET_LINES) && ps_remote.posted < PS_F_MOST)
        return 0;
    return ps_flush();
}
static inline void ps_hooked(int source, int64_t hook, int64_t argument)
{
    memcpy(&ps_remote.hooks[source].hook, &hook, sizeof ps_remote.hooks[source].hook);
    ps_remote.hooks[source].argument = (void *)(intptr_t)argument;
}
static inline int64_t ps_request(int32_t what, int64_t a, int64_t b)
{
    const char *text = (const char *)(intptr_t)a;
    size_t most = sizeof ps_remote.frame - PS_F_HEAD, length;
    if (what >= PS_SEND_SERIAL && what <= PS_SET_SERIAL_RATE) { /* nobody is at the other end of the line; to look takes time */
        if (what == PS_READ_SERIAL)
            ps_entry(PS_MICROS, 0, 0, 0, 0, 0);
        return what == PS_READ_SERIAL && a != 2 ? -1 : 0;
    }
    if (what > PS_LINE && what != PS_TIMER && (what < PS_SPEND || what > PS_OUT32) && what != PS_SET_LINES && what != PS_READ_LINES)
        ps_fail("windows, levels, lines of single chips and software interrupts are there in process only, not over TCP.");
    if (what != PS_LOG && what != PS_HOOK && what != PS_TIMER)
        return ps_entry(what, 0, 0, 0, a, b);
    if (!ps_remote.open)
        ps_connect();
    ps_flush();
    if (what == PS_HOOK) {
        ps_hooked(0, a, b);
        ps_put(ps_remote.frame + PS_F_HEAD, a != 0, 4);
        return ps_ask(PS_F_HOOK, 4);
    }
    if (what == PS_TIMER) {
        const int64_t *given = (const int64_t *)(intptr_t)a; /* which, level, period, hook, argument */
        if (given[0] < 0 || given[0] >= PS_F_TIMERS)
            ps_fail("over TCP there are timers 0 to 3.");
        ps_hooked(1 + (int)given[0], given[2] ? given[3] : 0, given[4]);
        ps_put(ps_remote.frame + PS_F_HEAD, (uint64_t)given[0], 4), ps_put(ps_remote.frame + PS_F_HEAD + 4, (uint64_t)given[1], 4);
        ps_put(ps_remote.frame + PS_F_HEAD + 8, given[3] ? (uint64_t)given[2] : 0, 8);
        return ps_ask(PS_F_TIMER, 16);
    }
    if (!text)
        ps_fail("ps_log(0): a null pointer is no text.");
    length = strlen(text) < most ? strlen(text) : most;
    memcpy(ps_remote.frame + PS_F_HEAD, text, length);
    return ps_ask(PS_F_LOG, length);
}
static inline int ps_until_line(uint32_t us) /* until the interrupt line is asserted, us at most: 1 if it is */
{
    return (int)ps_entry(PS_UNTIL_LINE, 0, 0, 0, us, 0);
}
static inline int ps_run_remote(int count, char **given, int (*run)(void))
{
    int code;
    ps_remote.address = count > 1 ? given[1] : 0;
    code = run();
    ps_flush();
    return code;
}

#endif
