"""Damaged files: bytes changed by chance, and numbers, names and shapes that lie."""

import functools
import io
import json
import struct
import zipfile
import zlib

import numpy as np


NUMBERS = [
    0,
    1,
    2,
    7,
    127,
    128,
    255,
    2**15,
    2**16,
    2**31 - 1,
    2**31,
    2**32 - 1,
    2**63 - 1,
    2**64 - 1,
]
NAMES = [
    "",
    ".",
    "..",
    "../a",
    "/etc/passwd",
    "/dev/zero",
    "a\0b",
    "out/a.png",
    "a" * 5000,
    "9" * 5000,
]
ODD = [None, True, False, -1, 0, 0.5, 1e-320, 1e30, -1e308, 1e308, float("nan"), float("inf")]
ODD += [2**31, 2**63, 10**400, [], {}, [[]], [{}], {"a": 1}, [1e308] * 3, [0] * 17, *NAMES]
WORDS = [
    b"nan",
    b"inf",
    b"-1",
    b"1e999",
    b"9" * 30,
    b"9" * 5000,
    b"\0",
    b"\n",
    b"\r\n",
    b" ",
    b"..",
    b"\xff",
]
WORDS += [b"element vertex 99999999999", b"property list char double a", b"property float x"]


def damaged(dice: np.random.Generator, content: bytes, kind: str) -> bytes:
    """What becomes of a file of this kind: json, npz, png, or any other."""
    whole = dice.random() < 0.3
    if kind == "json" and not whole:
        return _json(dice, content)
    if kind == "npz" and not whole:
        return damaged_npz(dice, content)
    if kind == "png" and not whole:
        return _png(dice, content)
    for _ in range(int(dice.integers(1, 5))):
        content = _bytes(dice, content)
    return content


def _bytes(dice, content):
    at, data = int(dice.integers(len(content) + 1)), bytearray(content)
    more = int(dice.integers(1, 9))
    match int(dice.integers(9)):
        case 0 | 1:
            if at < len(data):
                data[at] ^= 1 << int(dice.integers(8))
        case 2:
            data[at : at + more] = dice.bytes(more)
        case 3:
            del data[at : at + more]
        case 4:
            data = data[:at]
        case 5:
            size = int(dice.choice([1, 2, 4, 8]))
            number = NUMBERS[int(dice.integers(len(NUMBERS)))] % 256**size
            data[at : at + size] = number.to_bytes(size, str(dice.choice(["little", "big"])))
        case 6:
            data[at:at] = WORDS[int(dice.integers(len(WORDS)))]
        case 7:
            other = int(dice.integers(len(content) + 1))
            data[at:at] = content[other : other + int(dice.integers(1, 65))]
        case _:
            # A whole word of a text for another.
            begin = max(content.rfind(b" ", 0, at), content.rfind(b"\n", 0, at)) + 1
            ends = [x for x in (content.find(b" ", at), content.find(b"\n", at)) if x >= 0]
            data[begin : min(ends, default=at)] = WORDS[int(dice.integers(len(WORDS)))]
    return bytes(data)


def _json(dice, content):
    lines = content.split(b"\n") if content.count(b"\n{") else [content]
    pick = int(dice.integers(len([line for line in lines if line.strip()])))
    tree = json.loads(lines[pick])
    for _ in range(int(dice.integers(1, 4))):
        _change(dice, tree)
    if dice.random() < 0.01:
        tree = {"frames": "DEEP"}
        lines[pick] = json.dumps(tree).replace('"DEEP"', "[" * 5000 + "]" * 5000).encode()
    else:
        lines[pick] = json.dumps(tree).encode()
    return b"\n".join(lines)


def _change(dice, tree):
    """One value of a tree becomes another, goes, or is there twice."""
    places = [(tree, key) for key in _keys(tree)]
    for node, key in places:
        inner = node[key]
        if len(places) < 400:
            places += [(inner, k) for k in _keys(inner)]
    if not places:
        return
    node, key = places[int(dice.integers(len(places)))]
    match int(dice.integers(6)):
        case 0:
            node.pop(key)
        case 1 if isinstance(node, list):
            node.append(node[key])
        case 2:
            other, name = places[int(dice.integers(len(places)))]
            if name in _keys(other):
                node[key] = json.loads(json.dumps(other[name]))
        case 3 if isinstance(node[key], int | float) and not isinstance(node[key], bool):
            scale = float(dice.normal() * 10 ** dice.uniform(-3, 3))
            node[key] = scale * float(min(node[key], 2**1000))
        case _:
            node[key] = json.loads(json.dumps(ODD[int(dice.integers(len(ODD)))]))


def _keys(node):
    return (
        list(node) if isinstance(node, dict) else range(len(node)) if isinstance(node, list) else ()
    )


def damaged_npz(dice, content):
    """One entry is changed, and the archive is whole again."""
    entries = dict(_entries(content))
    name = list(entries)[int(dice.integers(len(entries)))]
    match int(dice.integers(8)):
        case 0:
            del entries[name]
        case 1:
            entries[name] = entries[list(entries)[int(dice.integers(len(entries)))]]
        case 2:
            entries[f"{NAMES[int(dice.integers(4, len(NAMES) - 2))].replace(chr(0), '')}.npy"] = (
                b"x"
            )
        case 3:
            shape = tuple(int(x) for x in dice.integers(0, 5, dice.integers(0, 5)))
            kind = str(dice.choice(["f4", "f8", "i4", "u1", "U3", "c8", "S2", "?"]))
            entries[name] = _npy(np.zeros(shape, kind))
        case 4 | 5:
            entries[name] = _header(dice, entries[name])
        case 6 if name == "header.npy":
            told = str(np.load(io.BytesIO(entries[name])))
            entries[name] = _npy(np.array(_json(dice, told.encode()).decode()))
        case _:
            entries[name] = _bytes(dice, entries[name])
    return packed(entries, deflated=dice.random() < 0.5)


@functools.lru_cache(maxsize=16)
def _entries(content):
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return [(name, archive.read(name)) for name in archive.namelist()]


def packed(entries, deflated):
    """A zip file; `zipfile` takes ten times as long to write one of many small entries."""
    files, index = bytearray(), bytearray()
    for name, data in entries.items():
        packed, title = _deflated(data) if deflated else data, name.encode()
        # Version, flags, method, time, date; sum and sizes; lengths of what follows.
        told = struct.pack("<HHHHH", 20, 0x800, 8 * deflated, 0, 0x21)
        told += struct.pack("<IIIHH", zlib.crc32(data), len(packed), len(data), len(title), 0)
        index += struct.pack("<IH", 0x02014B50, 20) + told
        index += struct.pack("<HHHII", 0, 0, 0, 0, len(files)) + title
        files += struct.pack("<I", 0x04034B50) + told + title + packed
    count = len(entries)
    last = struct.pack("<IHHHHIIH", 0x06054B50, 0, 0, count, count, len(index), len(files), 0)
    return bytes(files + index + last)


@functools.lru_cache(maxsize=1024)
def _deflated(data):
    packer = zlib.compressobj(wbits=-15)
    return packer.compress(data) + packer.flush()


def _npy(array):
    out = io.BytesIO()
    np.save(out, array)
    return out.getvalue()


def _png(dice, content):
    """A chunk is changed, packed pixels before they are packed, and the sums of all are right."""
    chunks, at = [], 8
    while at < len(content):
        size = int.from_bytes(content[at : at + 4], "big")
        chunks.append((content[at + 4 : at + 8], content[at + 8 : at + 8 + size]))
        at += 12 + size
    pick = int(dice.integers(len(chunks)))
    name, data = chunks[pick]
    unpacked = name == b"IDAT" and dice.random() < 0.7
    data = _bytes(dice, zlib.decompress(data) if unpacked else data)
    chunks[pick] = name, zlib.compress(data) if unpacked else data
    if dice.random() < 0.2:
        chunks.insert(pick, chunks[int(dice.integers(len(chunks)))])
    packed = (
        len(data).to_bytes(4, "big") + name + data + zlib.crc32(name + data).to_bytes(4, "big")
        for name, data in chunks
    )
    return content[:8] + b"".join(packed)


def _header(dice, data):
    """An array whose header tells another shape or kind than it has."""
    shapes = ["(99999999999,)", "(2, 999999999)", "(-1,)", "(0,)", "()", "(1,) * 9", "('a',)"]
    kinds = ["'|O'", "'<f8'", "'|V0'", "'<U999999999'", "[('a', '<f4')]", "'<M8[s]'", "'>f4'"]
    told = f"{{'descr': {dice.choice(kinds)}, 'fortran_order': {bool(dice.integers(2))}, "
    told += f"'shape': {dice.choice(shapes)}, }}"
    told = told.ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + len(told).to_bytes(2, "little") + told.encode() + data[128:]
