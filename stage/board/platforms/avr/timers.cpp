/* The timers of avr/timer_.h, compiled once for all programs. */
#define PULSESTAGE_TIMERS
#include <avr/interrupt.h>

namespace pulsestage
{
enum { EVENT_TIMER = 5, EVENT_LEVEL = 14, ROUTINE_LEVEL = 1, RESPONSE_CLOCKS = 40 };
enum Output { DISCONNECTED, TOGGLES, CLEARS, SETS };              /* COMnx1 and COMnx0 without PWM */
enum Counting { NORMAL, CLEAR_ON_COMPARE, FAST_PWM, CORRECT_PWM }; /* the last counts up and down */
enum TopValue { TOP_MAX, TOP_8_BITS, TOP_9_BITS, TOP_10_BITS, TOP_OCRA, TOP_ICR };

struct Mode {
    uint8_t counting, top;
};
static bool is_wide(int n) { return n != 0 && n != 2; }
#if defined(__AVR_ATmega2560__)
static int channels_of_timer(int n) { return is_wide(n) ? 3 : 2; }
#else
static int channels_of_timer(int) { return 2; }
#endif
static uint32_t greatest_count(int n) { return is_wide(n) ? 0xFFFF : 0xFF; }
static Mode mode_of(int n)
{
    static const Mode wide[16] = {
        {NORMAL, TOP_MAX},         {CORRECT_PWM, TOP_8_BITS}, {CORRECT_PWM, TOP_9_BITS}, {CORRECT_PWM, TOP_10_BITS},
        {CLEAR_ON_COMPARE, TOP_OCRA}, {FAST_PWM, TOP_8_BITS}, {FAST_PWM, TOP_9_BITS},    {FAST_PWM, TOP_10_BITS},
        {CORRECT_PWM, TOP_ICR},    {CORRECT_PWM, TOP_OCRA},   {CORRECT_PWM, TOP_ICR},    {CORRECT_PWM, TOP_OCRA},
        {CLEAR_ON_COMPARE, TOP_ICR}, {NORMAL, TOP_MAX},       {FAST_PWM, TOP_ICR},       {FAST_PWM, TOP_OCRA}};
    static const Mode narrow[8] = {{NORMAL, TOP_MAX},           {CORRECT_PWM, TOP_8_BITS}, {CLEAR_ON_COMPARE, TOP_OCRA},
                                   {FAST_PWM, TOP_8_BITS},      {NORMAL, TOP_MAX},         {CORRECT_PWM, TOP_OCRA},
                                   {NORMAL, TOP_MAX},           {FAST_PWM, TOP_OCRA}};
    const Timer &t = timer(n);
    return is_wide(n) ? wide[(t.a & 3) | (t.b >> 1 & 12)] : narrow[(t.a & 3) | (t.b >> 1 & 4)];
}
static uint32_t top_of(int n, Mode mode)
{
    static const uint16_t fixed[] = {0, 0xFF, 0x1FF, 0x3FF};
    const Timer &t = timer(n);
    return mode.top == TOP_MAX    ? greatest_count(n)
           : mode.top == TOP_OCRA ? t.compare[0]
           : mode.top == TOP_ICR  ? t.capture
                                  : fixed[mode.top];
}
static uint32_t period_of(int n, Mode mode)
{
    const uint32_t top = top_of(n, mode);
    if (mode.counting == CORRECT_PWM)
        return top ? 2 * top : 1;
    return (timer(n).is_above ? greatest_count(n) : top) + 1;
}
static uint16_t count_of(int n)
{
    const Mode mode = mode_of(n);
    const uint32_t top = top_of(n, mode), phase = timer(n).phase;
    return uint16_t(mode.counting == CORRECT_PWM && phase > top ? 2 * top - phase : phase);
}
static unsigned divider(int n)
{
    static const unsigned usual[] = {0, 1, 8, 64, 256, 1024, 0, 0}, second[] = {0, 1, 8, 32, 64, 128, 256, 1024};
    return (n == 2 ? second : usual)[timer(n).b & 7];
}
static bool is_buffered(int n)
{
    const Timer &t = timer(n);
    for (int x = 0; x < CHANNELS; x++)
        if (t.compare[x] != t.buffered[x])
            return true;
    return false;
}

/* --- time --- */

/* The rate of the processor's clock: F_CPU of the program, if it says one. */
static uint64_t clock_hz() { return &pulsestage_clock_hz ? pulsestage_clock_hz : F_CPU; }
static uint64_t now_ns() { return pulsestage_bus ? ps_nanoseconds() : 0; }
static uint64_t clocks_at(uint64_t ns) { return ns / 1000000000 * clock_hz() + ns % 1000000000 * clock_hz() / 1000000000; }
static uint64_t ns_of(uint64_t clocks)
{
    const uint64_t hz = clock_hz();
    return clocks / hz * 1000000000 + (clocks % hz * 1000000000 + hz - 1) / hz;
}

/* --- what happens while a timer counts --- */

/* How often the phase `event` comes in the `length` clocks behind the phase `from`. */
static uint64_t count_events(uint32_t event, uint32_t from, uint64_t length, uint32_t period)
{
    const auto passed = [&](uint64_t phase) { return phase < event ? 0 : (phase - event) / period + 1; };
    return passed(from + length) - passed(from);
}
/* The phases of the matches of a channel: one, or on the way up and down two; their number. */
static int find_matches(int n, Mode mode, int x, uint32_t period, uint32_t (&phases)[2])
{
    const uint32_t top = top_of(n, mode), compare = timer(n).compare[x];
    if (mode.counting != CORRECT_PWM) {
        phases[0] = (compare + 1) % period;
        return compare < period;
    }
    if (compare > top)
        return 0;
    phases[0] = (compare + 1) % period;
    phases[1] = (2 * top - compare + 1) % period;
    return phases[0] == phases[1] ? 1 : 2;
}
static int output_of(const Timer &t, int x) { return t.a >> (6 - 2 * x) & 3; }
static bool is_connected(int n, int x)
{
    const Mode mode = mode_of(n);
    const int output = output_of(timer(n), x);
    const bool is_pwm = mode.counting >= FAST_PWM;
    return output != DISCONNECTED && !(is_pwm && output == TOGGLES && !(x == 0 && mode.top >= TOP_OCRA));
}
static void set_output(Timer &t, int x, bool level) { t.levels = uint8_t((t.levels & ~(1 << x)) | int(level) << x); }
/* The level of an output behind `matches` matches and `wraps` returns to 0; the phase is that at the end. */
static void move_output(int n, Mode mode, int x, uint64_t matches, uint64_t wraps)
{
    Timer &t = timer(n);
    const int output = output_of(t, x);
    if (output == DISCONNECTED)
        return;
    if (output == TOGGLES)
        set_output(t, x, (t.levels >> x & 1) ^ (matches & 1));
    else if (mode.counting < FAST_PWM && matches)
        set_output(t, x, output == SETS);
    else if (mode.counting >= FAST_PWM && matches + wraps) {
        const uint32_t top = top_of(n, mode), compare = t.compare[x];
        const bool is_between = t.phase > compare && t.phase < 2 * top - compare + 1; /* of the matches up and down */
        const bool high = mode.counting == FAST_PWM ? t.phase <= compare : compare >= top || (compare && !is_between);
        set_output(t, x, high != (output == SETS));
    }
}
/* Counts on by `length` clocks, in which no register changes; with is_blocked by one clock. */
static void count_on(int n, Mode mode, uint32_t period, uint64_t length)
{
    Timer &t = timer(n);
    const uint32_t from = t.phase, top = top_of(n, mode);
    const uint64_t wraps = count_events(0, from, length, period);
    t.phase = uint32_t((from + length) % period);
    for (int x = 0; x < channels_of_timer(n); x++) {
        uint32_t phases[2];
        uint64_t matches = 0;
        for (int k = t.is_blocked ? 0 : find_matches(n, mode, x, period, phases); k--;)
            matches += count_events(phases[k], from, length, period);
        t.flags |= uint8_t((matches != 0) << (OCF0A + x));
        move_output(n, mode, x, matches, wraps);
    }
    if (wraps && (mode.counting != CLEAR_ON_COMPARE || period == greatest_count(n) + 1))
        t.flags |= 1 << TOV0;
    if (mode.top == TOP_ICR && !t.is_blocked && count_events(mode.counting == CORRECT_PWM ? top : 0, from, length, period))
        t.flags |= 1 << ICF1;
}
/* The clocks up to the phase at which OCRnx takes what was written, and the count the way of the mode. */
static uint32_t clocks_to_update(int n, Mode mode, uint32_t period)
{
    const uint32_t phase = timer(n).phase;
    const uint32_t update = mode.counting == CORRECT_PWM && mode.top < TOP_OCRA ? top_of(n, mode) : period;
    return update > phase ? update - phase : update + period - phase;
}
static void advance(int n)
{
    Timer &t = timer(n);
    const unsigned d = divider(n);
    const uint64_t ns = now_ns();
    if (!d || clocks_at(ns) / d <= t.tick)
        return;
    uint64_t left = clocks_at(ns) / d - t.tick;
    t.tick += left;
    while (left) {
        const Mode mode = mode_of(n);
        if (t.is_blocked && mode.counting != CORRECT_PWM && t.phase == top_of(n, mode))
            t.is_above = true;
        const uint32_t period = period_of(n, mode);
        const bool updates = t.is_above || is_buffered(n);
        const uint64_t to_update = updates ? clocks_to_update(n, mode, period) : left + 1;
        const uint64_t length = t.is_blocked ? 1 : left < to_update ? left : to_update;
        count_on(n, mode, period, length);
        t.is_blocked = false;
        left -= length;
        if (length == to_update) {
            t.is_above = false;
            memcpy(t.compare, t.buffered, sizeof t.compare);
        }
    }
}

/* --- output pins --- */

static int output_pin(int n, int x)
{
#if defined(__AVR_ATmega2560__)
    static const int8_t pins[TIMERS][CHANNELS] = {
        {PIN_OF('B', 7), PIN_OF('G', 5), NO_PIN},         {PIN_OF('B', 5), PIN_OF('B', 6), PIN_OF('B', 7)},
        {PIN_OF('B', 4), PIN_OF('H', 6), NO_PIN},         {PIN_OF('E', 3), PIN_OF('E', 4), PIN_OF('E', 5)},
        {PIN_OF('H', 3), PIN_OF('H', 4), PIN_OF('H', 5)}, {PIN_OF('L', 3), PIN_OF('L', 4), PIN_OF('L', 5)}};
#else
    static const int8_t pins[TIMERS][CHANNELS] = {{PIN_OF('D', 6), PIN_OF('D', 5), NO_PIN},
                                                  {PIN_OF('B', 1), PIN_OF('B', 2), NO_PIN},
                                                  {PIN_OF('B', 3), PIN_OF('D', 3), NO_PIN}};
#endif
    return pins[n][x];
}
int find_output(int pin)
{
    for (int k = 0; k < TIMERS * CHANNELS; k++)
        if (output_pin(k / CHANNELS, k % CHANNELS) == pin)
            return k;
    return -1;
}
/* Lets the pins have the levels of the outputs that are connected. */
static void drive_outputs()
{
    uint8_t connected[PORTS] = {}, levels[PORTS] = {};
    for (int n = 0; n < TIMERS; n++)
        for (int x = 0; x < CHANNELS; x++) {
            const int pin = output_pin(n, x);
            if (pin < 0 || !is_connected(n, x))
                continue;
            connected[pin >> 3] |= uint8_t(1 << (pin & 7));
            levels[pin >> 3] |= uint8_t((timer(n).levels >> x & 1) << (pin & 7));
        }
    pins().renew = renew_timers;
    for (int at = 0; at < PORTS; at++)
        if (connected[at] != pins().timed[at] || levels[at] != pins().timed_levels[at])
            change_timed(at, connected[at], levels[at]);
}

/* --- events and interrupts --- */

typedef void (*Routine)(void);
static Routine routine_of(int n, int bit) /* bit: of TIFRn */
{
#define PULSESTAGE_TIMER(n)                                                                                            \
    {pulsestage_TIMER##n##_OVF_vect, pulsestage_TIMER##n##_COMPA_vect, pulsestage_TIMER##n##_COMPB_vect,               \
     pulsestage_TIMER##n##_COMPC_vect, nullptr, pulsestage_TIMER##n##_CAPT_vect}
    const Routine routines[TIMERS][6] = {PULSESTAGE_TIMER(0), PULSESTAGE_TIMER(1), PULSESTAGE_TIMER(2),
#if defined(__AVR_ATmega2560__)
                                         PULSESTAGE_TIMER(3), PULSESTAGE_TIMER(4), PULSESTAGE_TIMER(5)
#endif
    };
#undef PULSESTAGE_TIMER
    return routines[n][bit];
}
static uint8_t flags_with_routines(int n)
{
    uint8_t flags = 0;
    for (int bit = 0; bit < 6; bit++)
        flags |= uint8_t((timer(n).mask >> bit & 1 && routine_of(n, bit)) << bit);
    return flags;
}
/* Whether edges of an output reach an axis. */
static bool is_seen(int n, int x)
{
    const int pin = output_pin(n, x);
    return pin >= 0 && is_connected(n, x) && pins().lines[pin >> 3] >> (pin & 7) & 1;
}
/* The clocks of the timer up to its next event that somebody sees; 0: there is none. */
static uint32_t clocks_to_event(int n)
{
    const Timer &t = timer(n);
    const Mode mode = mode_of(n);
    const uint32_t period = period_of(n, mode);
    const uint8_t wanted = uint8_t(flags_with_routines(n) & ~t.flags);
    uint32_t least = 0;
    const auto add = [&](uint32_t event) {
        const uint32_t clocks = event > t.phase ? event - t.phase : event + period - t.phase;
        least = !least || clocks < least ? clocks : least;
    };
    bool any = false;
    for (int x = 0; x < CHANNELS; x++) {
        uint32_t phases[2];
        const bool seen = is_seen(n, x);
        any |= seen;
        if (seen || wanted >> (OCF0A + x) & 1)
            for (int k = find_matches(n, mode, x, period, phases); k--;)
                add(phases[k]);
        if (seen && mode.counting == FAST_PWM)
            add(0);
    }
    if (wanted & 1 << TOV0)
        add(0);
    if (wanted & 1 << ICF1 && mode.top == TOP_ICR)
        add(mode.counting == CORRECT_PWM ? top_of(n, mode) : 0);
    if ((any || wanted) && (t.is_above || is_buffered(n))) {
        const uint32_t update = clocks_to_update(n, mode, period);
        least = !least || update < least ? update : least;
    }
    return least;
}
static void timer_event(void *);
static void schedule()
{
    static bool on;
    static uint32_t changes;
    if (!pulsestage_bus)
        return;
    for (uint32_t now = ++changes;; now = ++changes) {
        uint64_t next = 0;
        for (int n = 0; n < TIMERS; n++) {
            const unsigned d = divider(n);
            const uint32_t clocks = d ? clocks_to_event(n) : 0;
            if (clocks && (!next || (timer(n).tick + clocks) * d < next))
                next = (timer(n).tick + clocks) * d;
        }
        if (next || on) {
            on = next;
            const uint64_t ns = now_ns(), at = ns_of(next);
            ps_timer(EVENT_TIMER, EVENT_LEVEL, next ? (at > ns ? at - ns : 1) : 0, next ? timer_event : nullptr, nullptr);
        }
        if (now == changes)
            return; /* no event came meanwhile */
    }
}
void renew_timers()
{
    for (int n = 0; n < TIMERS; n++)
        advance(n);
    drive_outputs();
    schedule();
}

/* The routine of the interrupt that comes first of those that are enabled and wait, whose flag is cleared; 0: there is none. */
static Routine take_routine()
{
    static const uint8_t bits[] = {ICF1, OCF0A, OCF0B, OCF1C, TOV0};
    if (const Routine routine = take_pin_change())
        return routine;
    for (int k = 0; k < TIMERS; k++) {
        const int n = k < 3 ? 2 - k : k;
        const uint8_t waiting = uint8_t(timer(n).flags & flags_with_routines(n));
        for (int m = 0; waiting && m < FLAGS; m++)
            if (waiting >> bits[m] & 1) {
                timer(n).flags &= uint8_t(~(1 << bits[m]));
                return routine_of(n, bits[m]);
            }
    }
    return nullptr;
}
/* Calls the routines of timers and pin changes that wait, as SREG lets it. */
static void call_routines()
{
    Core &c = core();
    const InterruptLine &line = interrupt_line();
    while (pulsestage_bus && c.sreg & 0x80 && !(line.inside && !line.enabled)) {
        const Routine routine = take_routine();
        if (!routine)
            return;
        schedule();
        const int before = ps_level(ROUTINE_LEVEL); /* events of the timers come meanwhile */
        c.sreg &= 0x7F;
        c.routines++;
        ps_spend_ns(ns_of(RESPONSE_CLOCKS));
        routine();
        follow_pointers();
        c.routines--;
        c.sreg |= 0x80;
        ps_level(before);
    }
}
static void timer_event(void *)
{
    follow_pointers();
    renew_timers();
    call_routines();
}
/* SREG has changed. */
void call_waiting()
{
    if (!(core().sreg & 0x80))
        return;
    if (core().routines)
        ps_level(0); /* a routine that lets others interrupt it */
    call_routines();
    call_waiting_pins();
}

/* --- registers --- */

/* Before a register of timer n is read or written. */
static void come_to_now(int n)
{
    follow_pointers();
    advance(n);
}
/* After a register was written. */
static void use_registers()
{
    renew_timers();
    call_routines();
}
static void set_count(int n, uint32_t count)
{
    Timer &t = timer(n);
    const Mode mode = mode_of(n);
    const uint32_t top = top_of(n, mode);
    t.is_above = count > top && mode.counting != CORRECT_PWM;
    t.phase = mode.counting == CORRECT_PWM && count > top ? top : count & greatest_count(n);
    if (mode.counting < FAST_PWM)
        memcpy(t.compare, t.buffered, sizeof t.compare);
}
/* Changes what the mode or the top depends on. */
template <typename Change> static void change_mode(int n, Change change)
{
    come_to_now(n);
    const Mode mode = mode_of(n);
    const uint32_t count = count_of(n), top = top_of(n, mode), d = divider(n);
    change(timer(n));
    if (divider(n) && divider(n) != d)
        timer(n).tick = clocks_at(now_ns()) / divider(n);
    if (mode_of(n).counting != mode.counting || top_of(n, mode_of(n)) != top)
        set_count(n, count);
    use_registers();
}
void force_compare(int n, uint8_t strobes)
{
    const int channels = (strobes >> 7 & 1) | (strobes >> 5 & 2) | (strobes >> 3 & 4);
    come_to_now(n);
    for (int x = 0; mode_of(n).counting < FAST_PWM && x < CHANNELS; x++)
        if (channels >> x & 1)
            move_output(n, mode_of(n), x, 1, 0);
    use_registers();
}

/* --- what registers do --- */

void write_control_a(int n, uint8_t v)
{
    change_mode(n, [=](Timer &t) { t.a = v; });
}
void write_control_b(int n, uint8_t v)
{
    change_mode(n, [=](Timer &t) { t.b = uint8_t(is_wide(n) ? v : v & 0x0F); });
    if (!is_wide(n) && v & 0xC0)
        force_compare(n, v);
}
void write_mask(int n, uint8_t v)
{
    come_to_now(n);
    timer(n).mask = v;
    use_registers();
}
uint8_t read_flags(int n)
{
    ps_micros();
    come_to_now(n);
    return timer(n).flags;
}
void clear_flags(int n, uint8_t v)
{
    come_to_now(n);
    timer(n).flags &= uint8_t(~v);
    schedule();
}
uint16_t read_count(int n)
{
    ps_micros();
    come_to_now(n);
    return count_of(n);
}
void write_count(int n, uint16_t v)
{
    come_to_now(n);
    if (const unsigned d = divider(n))
        timer(n).tick = clocks_at(now_ns()) / d;
    set_count(n, v & greatest_count(n));
    timer(n).is_blocked = true;
    use_registers();
}
void write_capture(int n, uint16_t v)
{
    change_mode(n, [=](Timer &t) { t.capture = v; });
}
void write_compare(int n, int x, uint16_t v)
{
    if (mode_of(n).counting >= FAST_PWM && divider(n)) {
        come_to_now(n);
        timer(n).buffered[x] = uint16_t(v & greatest_count(n));
        use_registers();
    } else
        change_mode(n, [=](Timer &t) { t.compare[x] = t.buffered[x] = uint16_t(v & greatest_count(n)); });
}
void connect_output(int output, uint16_t compare)
{
    const int n = output / CHANNELS, x = output % CHANNELS;
    change_mode(n, [=](Timer &t) { t.a = uint8_t((t.a & ~(3 << (6 - 2 * x))) | CLEARS << (6 - 2 * x)); });
    come_to_now(n);
    timer(n).buffered[x] = compare;
    use_registers();
}
void disconnect_output(int pin)
{
    if (!(pins().timed[pin >> 3] >> (pin & 7) & 1))
        return;
    for (int n = 0; n < TIMERS; n++)
        for (int x = 0; x < CHANNELS; x++)
            if (output_pin(n, x) == pin)
                change_mode(n, [=](Timer &t) { t.a = uint8_t(t.a & ~(3 << (6 - 2 * x))); });
}
void begin_pwm()
{
    for (int n = 0; n < TIMERS; n++) {
        change_mode(n, [=](Timer &t) { t.a = uint8_t(n ? 1 << WGM10 : 1 << WGM01 | 1 << WGM00); });
        change_mode(n, [=](Timer &t) { t.b = n == 2 ? 4 : 3; });
    }
}
} // namespace pulsestage
