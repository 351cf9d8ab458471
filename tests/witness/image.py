"""Adapts the firmware's image to labwired, and can insert a fault.

labwired 0.25.0 lacks LDREXH and STREXH. Each pair becomes a plain load and a store that reports success. That is
correct if nothing interrupts between the two; exclusive access itself is not tested here. The rest of the image does
not change.
"""

import struct

from elftools.elf.elffile import ELFFile


class Unfit(Exception):
    """The image does not have the form that this program expects."""


def code(path):
    """Returns the bytes of an ELF file and the offsets (begin, end) of its executable sections."""
    with open(path, "rb") as file:
        data = bytearray(file.read())
        file.seek(0)
        sections = [s for s in ELFFile(file).iter_sections() if s["sh_type"] == "SHT_PROGBITS" and s["sh_flags"] & 4]
        return data, [(s["sh_offset"], s["sh_offset"] + s["sh_size"]) for s in sections]


def _halves(data, ranges):
    """Yields (offset, this half-word, the next one) for all half-words of code."""
    for begin, end in ranges:
        for at in range(begin, end - 3, 2):
            yield at, *struct.unpack_from("<HH", data, at)


def replace_half_word_exclusives(data, ranges):
    """Replaces LDREXH Rt, [Rn] by LDRH.W, and STREXH Rd, Rt, [Rn] by STRH Rt, [Rn] and MOVS Rd, #0 (ARM DDI 0403,
    A7.7). Returns the number of pairs."""
    loads, stores = [], []
    for at, first, second in _halves(data, ranges):
        if first & 0xFFF0 == 0xE8D0 and second & 0x0FFF == 0x0F5F:
            loads.append(at)
            struct.pack_into("<HH", data, at, 0xF8B0 | first & 15, second & 0xF000)
        elif first & 0xFFF0 == 0xE8C0 and second & 0x0FF0 == 0x0F50:
            address, value, status = first & 15, second >> 12, second & 15
            if max(address, value, status) > 7:
                raise Unfit(f"STREXH at offset {at:#x} uses a high register: there is no short store for it")
            stores.append(at)
            struct.pack_into("<HH", data, at, 0x8000 | address << 3 | value, 0x2000 | status << 8)
    if len(loads) != len(stores) or any(not 0 < store - load <= 16 for load, store in zip(loads, stores, strict=False)):
        raise Unfit("LDREXH and STREXH do not come in pairs")
    return len(loads)


def _move(first, second):
    """Decodes a MOVW or MOVT to (is MOVT, register, 16-bit immediate); returns None for any other instruction."""
    if first & 0xFB70 != 0xF240 or second & 0x8000:
        return None
    value = (first & 15) << 12 | (first >> 10 & 1) << 11 | (second >> 12 & 7) << 8 | second & 0xFF
    return bool(first & 0x80), second >> 8 & 15, value


def _with_immediate(first, second, value):
    first = first & ~0x040F | value >> 12 | (value >> 11 & 1) << 10
    return first, second & ~0x70FF | (value >> 8 & 7) << 12 | value & 0xFF


def replace_constant(data, ranges, old, new):
    """Replaces the number `old` by `new` wherever a pair of MOVW and MOVT loads it. Returns the number of replacements;
    raises Unfit if there are none."""
    low, found = {}, 0
    for at, first, second in _halves(data, ranges):
        move = _move(first, second)
        if not move:
            continue
        is_high, register, value = move
        if not is_high:
            low[register] = (at, value)
            continue
        at_low, value_low = low.get(register, (0, 0))
        if value << 16 | value_low == old and at - at_low <= 32:
            struct.pack_into("<HH", data, at_low, *_with_immediate(*struct.unpack_from("<HH", data, at_low), new & 0xFFFF))
            struct.pack_into("<HH", data, at, *_with_immediate(first, second, new >> 16))
            found += 1
    if not found:
        raise Unfit(f"the image loads {old:#010x} nowhere: this fault needs another constant")
    return found


def fitted(path, to, fault=None):
    """Writes the image for labwired, optionally with a fault (old constant, new constant). Returns the numbers of
    replaced pairs and constants."""
    data, ranges = code(path)
    pairs = replace_half_word_exclusives(data, ranges)
    sites = replace_constant(data, ranges, *fault) if fault else 0
    to.write_bytes(data)
    return pairs, sites
