"""Profiles the cycles of a case, by exception and by function.

Counts the cycles of each instruction, including waits for registers, from the call of `begin`. Excludes entries into
exceptions, returns, and sleep. An exception is shown by the name of its vector: src/firmware/main.rs tells which task a
vector runs. Handlers with the same code share a name. The cycles of an inlined function count for the function that
contains it.
"""

import collections
import ctypes
import re

from .core import compiled

FLASH = 0x08000000
MOST = 40
"""Maximum number of functions shown."""
ESCAPES = {"$LT$": "<", "$GT$": ">", "$C$": ",", "$RF$": "&", "$BP$": "*", "$LP$": "(", "$RP$": ")"}


def _counts(name, count):
    return (ctypes.c_uint64 * count).in_dll(compiled(), name)


def begin():
    ctypes.c_uint32.in_dll(compiled(), "is_profiled").value = 1


def readable(symbol):
    """Returns the source name for a symbol mangled by rustc. Generic arguments are shown only if the symbol contains
    them."""
    if not (match := re.fullmatch(r"_ZN(.*)17h[0-9a-f]{16}E", symbol)):
        return symbol
    left, parts = match[1], []
    while left:
        length = re.match(r"[0-9]+", left)[0]
        end = len(length) + int(length)
        parts.append(left[len(length) : end])
        left = left[end:]
    name = "::".join(part.removeprefix("_") for part in parts)
    name = re.sub(r"\$u([0-9a-f]+)\$", lambda code: chr(int(code[1], 16)), name)
    for escape, text in ESCAPES.items():
        name = name.replace(escape, text)
    return name.replace("..", "::")


def table(image):
    """Yields the lines of the profile, highest cost first."""
    spent_at, spent_in = _counts("spent_at", 1 << 18), _counts("spent_in", 512)
    total = sum(spent_in)
    vectors = next(data for at, data in image.segments if at == FLASH)
    yield f"{total} cycles at work"
    for number in sorted(range(512), key=lambda number: -spent_in[number]):
        if spent_in[number]:
            vector = int.from_bytes(vectors[4 * number :][:4], "little") & ~1
            name = f"exception {number} ({image.function(vector)})" if number else "between exceptions"
            yield f"{100 * spent_in[number] / total:5.1f} %  {name}"
    functions = collections.Counter()
    for half, cycles in enumerate(spent_at):
        if cycles:
            functions[image.function(FLASH + 2 * half)] += cycles
    yield "of which"
    for name, cycles in functions.most_common(MOST):
        yield f"{100 * cycles / total:5.1f} %  {readable(name)}"
