#!/usr/bin/env python3
"""Packs what fuzzing found into fuzz/corpora, one file a target, and unpacks it again: corpora.py pack|unpack [TARGET...].

A file has inputs one after the other, each behind its length (four bytes, lowest first), the shortest first; tests/corpora runs them.
What a target packs is cut to a size that a repository bears: fuzz/run makes the inputs few before (each adds something that no other
has), and the longest are left out.
"""

import pathlib
import struct
import sys

HERE = pathlib.Path(__file__).resolve().parent
MOST_BYTES = 256 * 1024
TARGETS = sorted(path.stem for path in (HERE / "fuzz_targets").glob("*.rs"))


def pack(target):
    """Shortest first, as many as there is room for."""
    found = {path.read_bytes() for path in (HERE / "corpus" / target).glob("*")}
    packed = b""
    for data in sorted(found, key=lambda data: (len(data), data)):
        if len(packed) + 4 + len(data) <= MOST_BYTES:
            packed += struct.pack("<I", len(data)) + data
    (HERE / "corpora").mkdir(exist_ok=True)
    (HERE / "corpora" / target).write_bytes(packed)
    print(f"{target}: {len(packed)} bytes of {len(found)} inputs")


def unpack(target):
    """Each input under a name of its place."""
    directory = HERE / "corpus" / target
    directory.mkdir(parents=True, exist_ok=True)
    packed = (HERE / "corpora" / target).read_bytes()
    at = number = 0
    while at < len(packed):
        (length,) = struct.unpack_from("<I", packed, at)
        (directory / f"kept{number}").write_bytes(packed[at + 4 : at + 4 + length])
        at, number = at + 4 + length, number + 1


def main():
    what, targets = sys.argv[1], sys.argv[2:] or TARGETS
    for target in targets:
        if what == "pack":
            pack(target)
        elif what == "unpack" and (HERE / "corpora" / target).exists():
            unpack(target)


if __name__ == "__main__":
    main()
