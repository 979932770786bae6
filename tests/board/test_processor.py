"""Instructions behind an access to a window do to registers, memory and flags what the processor does to them."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from support.compiled_firmware import firmware

from stage import Stage
from stage.board import Board, NativeHost, memory_mapped_ports
from stage.native import COMPILED

pytestmark = pytest.mark.skipif(not memory_mapped_ports.is_supported(), reason="windows need Linux on x86-64")

NAMES = {8: "rax rbx rcx rdx", 4: "eax ebx ecx edx", 2: "ax bx cx dx", 1: "al bl cl dl"}
LETTERS = {8: "q", 4: "l", 2: "w", 1: "b"}
CF, PF, AF, ZF, SF, OF = 1, 4, 16, 64, 128, 2048
EACH = 8 if COMPILED else 2
ALL = CF | PF | AF | ZF | SF | OF


STRING = (
    "movq %rsi, %r8\n push %rdi\n leaq 8(%rsi), %rdi\n {}\n movq %rdi, %rdx\n subq %r8, %rdx\n movq %rsi, %rbx\n"
    " subq %r8, %rbx\n movq %r8, %rsi\n pop %rdi"
)
"""A string instruction from memory to the word behind it; how far it has gone is in %rbx and %rdx, how often in %rcx."""


CONDITIONS = "o no b ae e ne be a s ns p np l ge le g".split()


def arithmetic(size: int, letter: str) -> Iterator[tuple[str, int]]:
    a, b, _, d = (f"%{name}" for name in NAMES[size].split())
    for name in "add or adc sbb and sub xor cmp".split():
        for text in (f"{b}, {a}", f"{b}, (%rsi)", f"(%rsi), {d}", f"$-7, {a}", "$0x5a, (%rsi)"):
            yield f"{name}{letter} {text}", ALL
    yield f"add{letter} ${0x12 if size == 1 else 0x1234}, {a}", ALL
    for name in "inc dec neg".split():
        yield from ((f"{name}{letter} {where}", ALL) for where in (a, "(%rsi)"))
    yield from ((f"not{letter} {where}", ALL) for where in (b, "(%rsi)"))
    for text in (f"{b}, {a}", f"$0x41, {d}", f"$0x41, {a}", f"{b}, (%rsi)"):
        yield f"test{letter} {text}", ALL


def shifts(size: int, letter: str) -> Iterator[tuple[str, int]]:
    a, _, _, d = (f"%{name}" for name in NAMES[size].split())
    for name in "shl shr sar".split():
        yield from ((f"{name}{letter} {where}", ALL & ~AF) for where in (a, "(%rsi)"))
        yield f"{name}{letter} $5, {d}", ALL & ~AF & ~OF
        if size > 2:  # of shorter ones flags are undefined where all is shifted out
            yield f"{name}{letter} %cl, {a}", ALL & ~AF & ~OF
    for name in ("rol", "ror") if size < 8 else ():
        yield from ((f"{name}{letter} {where}", ALL & ~AF) for where in (a, "(%rsi)"))
        yield f"{name}{letter} $3, {a}", ALL & ~AF & ~OF


def moves(size: int, letter: str) -> Iterator[tuple[str, int]]:
    a, b, _, d = (f"%{name}" for name in NAMES[size].split())
    yield from ((f"xchg{letter} {b}, {where}", ALL) for where in (a, "(%rsi)"))
    for text in (f"{b}, 8(%rsi)", f"-8(%rsi), {a}", "$-3, (%rsi)", f"$0x31, {d}"):
        yield f"mov{letter} {text}", ALL


def longer_than_a_byte(size: int, letter: str) -> Iterator[tuple[str, int]]:
    a, b, _, d = (f"%{name}" for name in NAMES[size].split())
    for name in ("bt", "bts", "btr", "btc"):
        yield from ((f"{name}{letter} {text}", CF) for text in (f"$9, {a}", "$3, (%rsi)", f"{b}, {a}"))
    yield from ((f"cmov{condition} (%rsi), {a}", ALL) for condition in CONDITIONS)
    yield f"lea{letter} -5(%rsi,%rcx,4), {d}", ALL
    if size < 8:
        for text in (f"(%rsi), {a}", f"$-300, {b}, {d}", f"$7, {b}, {d}"):
            yield f"imul{letter} {text}", CF | OF


def strings() -> Iterator[tuple[str, int]]:
    for repeat in ("", "movl $2, %ecx\n rep ", "xorl %ecx, %ecx\n rep "):
        for name in ("movs", "stos"):
            for letter in LETTERS.values():
                if letter != "q" or "2" not in repeat:  # there is room for one
                    yield STRING.format(f"{repeat}{name}{letter}"), 0


def instructions() -> list[tuple[str, int]]:
    """Each with the flags that it defines. (%rsi) is memory; -8(%rsi) and 8(%rsi) as well."""
    matches: list[tuple[str, int]] = []
    for size, letter in LETTERS.items():
        matches += [*arithmetic(size, letter), *shifts(size, letter), *moves(size, letter)]
        if size > 1:
            matches += longer_than_a_byte(size, letter)
    for condition in CONDITIONS:
        matches += [(f"set{condition} %dl", ALL), (f"j{condition} 1f\n movl $77, %eax\n1:", ALL)]
    for text in "movzbl %ah,%ebx|movzwl (%rsi),%edx|movzbq (%rsi),%rdx|movsbw (%rsi),%dx|movswl %bx,%eax|movslq (%rsi),%rax".split(
        "|"
    ):
        matches.append((text, ALL))
    for text in (
        "movb (%rsi), %ah", "movb %ah, -8(%rsi)", "movb %bh, %bl",
        "movb %ch, %al", "movb %bl, %dh", "addb %ah, %bh", "cbtw", "cwtl", "cltq", "cwtd", "cltd", "cqto", "nop", "nopw 8(%rax)",
        "push %rbx\n pop %rdx", "push $-5\n pop %rbx", "push (%rsi)\n pop %rax", "call 1f\n jmp 2f\n1: incq %rax\n ret\n2:",
        "movabs $0x123456789abcdef, %rdx", "movl $9, %r8d\n addq %r8, %rax\n movq %r8, %rbx", "xchg %rax, %rdx", "pause", "endbr64",
        "lea 1f(%rip), %rdx\n jmp *%rdx\n ud2\n1: xor %edx, %edx",
        "leal -5(%esi,%ecx,4), %edx", "movl $9, %r8d\n addb %r8b, %al\n movb %al, %r8b\n movb %r8b, %dl",
        "movl $1, %r8d\n movzbl 3(%rsi,%r8,2), %edx", "movq %rsi, %r8\n movq (%r8), %rax\n movw %bx, -8(%r8)",
        "push %rbp\n movq %rsp, %rbp\n push %rax\n leave", "shll $0, %eax", "shrb $0, (%rsi)", "sarq $0, %rdx",
    ):  # fmt: skip
        matches.append((text, ALL))
    for text in ("rolb $11, %al", "rorw $19, %ax", "rolw $21, (%rsi)", "rorb $9, %dl"):
        matches.append((text, CF | ZF))
    matches += [(text, 0) for text in ("shlb $8, %al", "shlb $9, %dl", "shrw $16, %ax", "shrb $12, %al")]
    return matches + list(strings())


CHECK = r"""
#define L (unsigned long long)
struct all { uint64_t r[4], flags; };
static uint64_t memory[3], plain;
static uint64_t word(void)
{
    static uint64_t x = 88172645463325252u;
    static const uint64_t edges[] = {0, 1, 0x7f, 0x80, 0xff, 0x7fff, 0x8000, 0x7fffffff, 0x80000000, ~0ull, 1ull << 63, 0xffffffff};
    x ^= x << 13, x ^= x >> 7, x ^= x << 17;
    return x % 3 ? x : edges[x / 3 % 12];
}
#define BOTH(text) static void NAME(struct all *s, volatile void *w) { __asm__ volatile( \
    "pushq %5\n popfq\n movzwl (%6), %%r15d\n" text "\n movzwl (%6), %%r15d\n pushfq\n popq %5\n" \
    : "+a"(s->r[0]), "+b"(s->r[1]), "+c"(s->r[2]), "+d"(s->r[3]), "+m"(memory), "+r"(s->flags) \
    : "r"(w), "S"(&memory[1]) : "r15", "r8", "cc"); }
"""


def program(texts: list[str]) -> str:
    """Does each instruction with random registers, flags, memory, by the processor and behind a window; logs what differs."""
    lines = [CHECK]
    for k, text in enumerate(texts):
        code = " ".join(f'"{line}\\n"' for line in text.replace("%", "%%").split("\n"))
        lines += [f"#define NAME f{k}", f"BOTH({code})", "#undef NAME"]
    names, output = (", ".join(each) for each in zip(*((f"f{k}", f'"{t}"') for k, t in enumerate(texts)), strict=True))
    lines.append(f"static void (*const each[])(struct all *, volatile void *) = {{{names}}};")
    lines.append(f"static const char *const texts[] = {{{output}}};".replace("\n", " ; "))
    lines.append(
        r"""
    #include <string.h>
    PULSESTAGE_MAIN
    {
        volatile void *window = ps_window(0x300, 16);
        int wrong = 0;
        for (unsigned k = 0; k < sizeof each / sizeof *each; k++)
            for (int n = 0; n < EACH; n++) {
                struct all s = {{word(), word(), word(), word()}, 0x202 | (word() & 0x8d5)}, t = s;
                uint64_t m[3] = {word(), word(), word()}, after[3];
                memcpy(memory, m, sizeof m);
                each[k](&s, &plain);
                memcpy(after, memory, sizeof m);
                memcpy(memory, m, sizeof m);
                each[k](&t, window);
                s.flags &= masks[k], t.flags &= masks[k];
                if (memcmp(&s, &t, sizeof s) || memcmp(after, memory, sizeof m)) {
                    ps_logf("%s: rax %llx, rdx %llx, flags %llx; by the window %llx, %llx, %llx", texts[k],
                        L s.r[0], L s.r[3], L s.flags, L t.r[0], L t.r[3], L t.flags);
                    wrong++;
                    break;
                }
            }
        return wrong;
    }"""
    )
    return "\n".join(lines)


def test_emulated_instructions_do_what_the_processor_does():
    table = instructions()
    masks = ", ".join(str(mask) for _, mask in table)
    head = f"enum {{ EACH = {EACH} }};\nstatic const uint64_t masks[] = {{{masks}}};\n"
    library = firmware(head + program([text for text, _ in table]), "-mno-red-zone", "-O1")
    board = Board(Stage("xy", visuals=False))
    done = NativeHost(library, board).run()
    assert board.log == []
    assert done.code == 0
    assert board.link.record["faults"] == EACH * len(table), (
        "one for each, since what is between two accesses needs none"
    )
    assert board.cycles == 4 * EACH * len(table), "a word of a bus of 8 bits is two cycles"


def test_what_only_the_processor_can_do_is_left_to_it():
    """lock add in memory, xchg with r8, rep movsb backwards: each is done by the processor, and the next access faults again"""
    texts = [
        "lock addq %rbx, (%rsi)", "xchg %rax, %r8\n xchg %r8, %rax", STRING.format("std\n movsb\n cld"), "rolq $5, %rax",
        "cpuid\n xorl %eax, %eax\n xorl %ebx, %ebx\n xorl %ecx, %ecx\n xorl %edx, %edx",
    ]  # fmt: skip
    head = f"enum {{ EACH = 2 }};\nstatic const uint64_t masks[] = {{{', '.join('0' for _ in texts)}}};\n"
    library = firmware(head + program(texts), "-mno-red-zone", "-O1")
    board = Board(Stage("xy", visuals=False))
    done = NativeHost(library, board).run()
    assert (board.log, done.code) == ([], 0)
    assert board.link.record["faults"] == 2 * 2 * len(texts)


def test_64_bits_are_two_accesses_of_32_the_low_half_first():
    """*(volatile uint64_t *)window, written and read"""
    body = """PULSESTAGE_MAIN
    {
        volatile uint64_t *w = ps_window(0x300, 16);
        w[1] = 0x1122334455667788u;
        ps_logf("%llx", (unsigned long long)w[1]);
        return 0;
    }"""
    board = Board(Stage("xy", visuals=False))
    board.add_device(range(0x308, 0x310), read=lambda port: port & 0xFF, width=16)
    NativeHost(firmware(body), board).run()
    assert [(c.direction, c.port, c.value) for c in board.trace] == [
        *(("W", 0x308 + k, 0x1122334455667788 >> 8 * k & 0xFFFF) for k in (0, 2, 4, 6)),
        *(("R", port, port & 0xFF) for port in (0x308, 0x30A, 0x30C, 0x30E)),
    ]
    assert board.log[0][1] == "e000c000a0008"
