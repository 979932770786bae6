"""Value changes of a VCD file, decoded into an array: compiled."""

from __future__ import annotations

from stage.native import array_of, exported, hot, record

CHANGE = record([(name, "i8") for name in "time signal level".split()])
"""A change: time, in units of the file's timescale; index of the signal; its level, 0 or 1."""
SUMMARY = record([(name, "i8") for name in "begin end n wrong".split()])
"""First and last time of the file (-1: it has none); number of changes; place of the first byte that is not VCD, or -1."""
HASH_SPACE = 1 << 55
MAX_TIME = 1 << 59
SPACE = 32
HASH, DOLLAR, DOT, ZERO, NINE = (ord(c) for c in "#$.09")
SCALARS, VECTORS = tuple(b"01xXzZuUwWlLhH-"), tuple(b"bBrRsS")
LOW, HIGH = tuple(b"0lL"), tuple(b"1hH")
COMMENT, END = tuple(b"$comment"), tuple(b"$end")


@hot
def hash_identifier(text, begin, end):
    """Return a number that stands for the identifier code text[begin:end] of a signal."""
    code = 0
    for k in range(begin, end):
        code = (code * 95 + int(text[k]) - SPACE) % HASH_SPACE
    return code


@hot
def _skip_spaces(text, position):
    """Return the position of the first byte of a VCD text from `position` on that is no space."""
    while position < len(text) and text[position] <= SPACE:
        position += 1
    return position


@hot
def _find_word_end(text, position):
    """Return the position after the word that begins at `position`."""
    while position < len(text) and text[position] > SPACE:
        position += 1
    return position


@hot
def _is_word(text, begin, end, word):
    """Return whether text[begin:end] is a word, a tuple of bytes."""
    matching = 0
    if end - begin == len(word):
        for k in range(len(word)):
            matching += text[begin + k] == word[k]
    return matching == len(word)


@hot
def _parse_time(text, begin, end):
    """Return the number in text[begin:end], which may have a fraction of zeros; -1 if it is none."""
    value, digits, in_fraction = 0, 0, False
    for k in range(begin, end):
        c = int(text[k])
        if c == DOT and not in_fraction:
            in_fraction = True
        elif in_fraction and c == ZERO:
            continue
        elif ZERO <= c <= NINE and not in_fraction and value < MAX_TIME // 10:
            value, digits = 10 * value + c - ZERO, digits + 1
        else:
            return -1
    return value if digits else -1


@hot
def _to_level(character):
    """Return the level, 0 or 1, that a character of a VCD file stands for; -1 for x and z, at which a line keeps its level."""
    return 0 if character in LOW else 1 if character in HIGH else -1


@hot
def _find_bit_level(text, begin, end, bit):
    """Return the level of a bit of a value, text[begin:end], or -1; bit 0 is the last. A short value goes on with 0, x or z."""
    if begin >= end:
        return -1
    k = end - 1 - bit
    if k >= begin:
        return _to_level(int(text[k]))
    return 0 if _to_level(int(text[begin])) >= 0 else -1


@hot
def _skip_command(text, begin, end):
    """Return the end of a command such as $dumpvars; for $comment, the position after its $end."""
    if not _is_word(text, begin, end, COMMENT):
        return end
    while begin < end and not _is_word(text, begin, end, END):
        begin = _skip_spaces(text, end)
        end = _find_word_end(text, begin)
    return end


@exported(None, array_of("u1"), "i8", array_of("i8"), array_of("i8"), array_of(CHANGE), SUMMARY)
def decode_changes(text, position, codes, bits, out, summary):
    """Decode the changes of some signals into `out`, as many as fit, and count all of them.

    Args:
        text: The file.
        position: Place of the first byte after its declarations.
        codes: `hash_identifier` of each signal.
        bits: Bit of each signal, 0 for the last of its value.
        out: CHANGE records, or none.
        summary: SUMMARY, filled.
    """
    summary.begin, summary.end, summary.n, summary.wrong = -1, -1, 0, -1
    position = _skip_spaces(text, position)
    while position < len(text):
        end, c = _find_word_end(text, position), int(text[position])
        begin = position + 1
        if c == HASH:
            time = _parse_time(text, begin, end)
            if time < 0 or time < summary.end:
                summary.wrong = position
                return
            summary.begin = time if summary.begin < 0 else summary.begin
            summary.end = time
        elif c == DOLLAR:
            end = _skip_command(text, position, end)
        elif c in SCALARS or c in VECTORS:
            summary.begin = max(summary.begin, 0)  # levels before the first time are those of time 0
            value, value_end = position, begin
            if c in VECTORS:
                value, value_end = begin, end
                begin = _skip_spaces(text, end)
                end = _find_word_end(text, begin)
            code = hash_identifier(text, begin, end)
            for i in range(len(codes)):
                level = _find_bit_level(text, value, value_end, bits[i]) if codes[i] == code else -1
                if level >= 0:
                    if summary.n < len(out):
                        out[summary.n].time = summary.end if summary.end > 0 else 0
                        out[summary.n].signal = i
                        out[summary.n].level = level
                    summary.n += 1
        else:
            summary.wrong = position
            return
        position = _skip_spaces(text, end)
