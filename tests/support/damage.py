"""Damage to files as disks, networks and editors do it, and hostile documents, for tests of readers."""

import io
import json
import random
import zipfile

HOSTILE = (
    None, True, -1, 0, 1 << 63, 1 << 200, 10**400, -1e308, "1e400", "", "x" * 100_000,
    [], {}, [[]] * 3, {"": None}, "NaN", "Infinity",
)  # fmt: skip
"""What takes the place of a value in a document. "1e400", "NaN" and "Infinity" are written without quotes."""


def damage(rng: random.Random, data: bytes) -> bytes:
    """Return `data` with bits flipped, its end cut off, two blocks swapped, or a block lost or repeated."""
    changed, kind = bytearray(data), rng.randrange(5)
    size = min(rng.choice((1, 8, 64, 512)), len(data) // 2)
    a, b = sorted(rng.randrange(len(data) - size + 1) for _ in range(2))
    if kind == 0:
        for _ in range(rng.choice((1, 1, 1, 2, 20))):
            changed[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    elif kind == 1:
        del changed[rng.randrange(len(data)) :]
    elif kind == 2:
        changed[a : a + size], changed[b : b + size] = data[b : b + size], data[a : a + size]
    elif kind == 3:
        del changed[a : a + size]
    else:
        changed[a:a] = data[b : b + size]
    return bytes(changed)


def replace_value(rng: random.Random, document) -> str:
    """Return a document as JSON text in which a hostile value stands in the place of another one."""
    document = json.loads(json.dumps(document))
    places = []
    walk = [document]
    while walk:
        value = walk.pop()
        inner = list(value.items()) if isinstance(value, dict) else list(enumerate(value))
        places += [(value, key) for key, _ in inner]
        walk += [each for _, each in inner if isinstance(each, dict | list)]
    holder, key = rng.choice(places)
    holder[key] = rng.choice(HOSTILE)
    text = json.dumps(document)
    for word in ("1e400", "NaN", "Infinity"):
        text = text.replace(f'"{word}"', word)
    return text


def zipped(members, method=zipfile.ZIP_DEFLATED):
    """Return a zip archive of these members, (name, content) each."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", method) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return out.getvalue()
