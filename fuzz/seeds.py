#!/usr/bin/env python3
"""Writes first inputs for fuzzing into fuzz/corpus: whole files and messages, from which the fuzzer cuts and bends its own.

Images are in fuzz/seeds; the rest comes from what the project has: the golden messages, the flight file, the catalogue.
"""

import math
import pathlib
import struct

HERE = pathlib.Path(__file__).resolve().parent
PROJECT = HERE.parent
FIELD_PX, PLATESCALE = (160, 128), math.radians(200 / 3600)  # as in fuzz_targets/solve.rs


def put(target, name, data):
    directory = HERE / "corpus" / target
    directory.mkdir(parents=True, exist_ok=True)
    (directory / name).write_bytes(data)


def messages():
    for path in sorted((PROJECT / "proto/golden").glob("*/*.hex")):
        lines = (line.split("#")[0] for line in path.read_text().splitlines())
        frame = bytes.fromhex("".join(lines))
        put("wire", path.stem, bytes([7]) + frame)
        # Between the sync word with the length, and the checksum: kind, version, body.
        put("body", path.stem, frame[8:-4])


def catalogue():
    """The first 200 stars; the target puts the checksums right."""
    head = bytearray((PROJECT / "config/catalog/stars.bin").read_bytes()[: 64 + 200 * 17])
    head[12:16] = struct.pack("<I", 200)
    put("catalogue", "head", bytes(head))
    put("catalogue", "one", bytes(head[:12]) + struct.pack("<I", 1) + bytes(head[16 : 64 + 17]))


def sky(ra, dec, stars=16):
    """A frame of real stars, in the five bytes a star of the target."""
    data = (PROJECT / "config/catalog/stars.bin").read_bytes()
    (count,) = struct.unpack_from("<I", data, 12)
    drawn = []
    for index in range(min(count, 20000)):
        star_ra, star_dec = struct.unpack_from("<Ii", data, 64 + 17 * index)
        a, d = star_ra * math.tau / 2**32 - ra, star_dec * math.tau / 2**32
        depth = math.sin(dec) * math.sin(d) + math.cos(dec) * math.cos(d) * math.cos(a)
        if depth < 0.9:
            continue
        east = math.cos(d) * math.sin(a) / depth / PLATESCALE
        north = (math.cos(dec) * math.sin(d) - math.sin(dec) * math.cos(d) * math.cos(a)) / depth / PLATESCALE
        x, y = FIELD_PX[0] / 2 - east, FIELD_PX[1] / 2 + north
        if 3 < x < FIELD_PX[0] - 3 and 3 < y < FIELD_PX[1] - 3:
            drawn.append((x * 256 / FIELD_PX[0], y * 256 / FIELD_PX[1]))
    body = b"".join(bytes([int(x), int(y), max(20, 200 - 10 * n), 12, 0]) for n, (x, y) in enumerate(drawn[:stars]))
    return bytes([4, 20, 255, min(stars, len(drawn))]) + body


def view():
    """The golden packets in the pieces of the target, behind their lengths, without what it puts right itself."""
    packed, at, pieces = (PROJECT / "proto/golden/view/small.packets").read_bytes(), 0, []
    while at < len(packed):
        (length,) = struct.unpack_from("<H", packed, at + 10)
        pieces.append(packed[at + 12 : at + 12 + length])
        at += 16 + length
    whole = [bytes([1, number]) + struct.pack("<H", len(piece)) + piece for number, piece in enumerate(pieces)]
    put("view", "whole", b"".join(whole))
    put("view", "head", whole[0])
    put("view", "late", b"".join(whole[1:4] + whole[:1] + whole[4:6]))


def main():
    messages()
    view()
    catalogue()
    put("index", "head", b"STARSIDX" + struct.pack("<I", 1))
    put("index", "altered", bytes([0xFF, 200, 1, 0, 0, 7, 100, 0, 0, 40, 255]))
    for n, (ra, dec) in enumerate([(1.4, 0.1), (4.2, -0.5), (5.4, 0.8)]):
        put("solve", f"sky{n}", sky(ra, dec))
    put("solve", "blank", bytes([4, 0, 255, 0]))
    put("bad_pixels", "list", b"# dead\n3 4\n23 15\n0 0\n")
    for n, line in enumerate([b"fmin:-137  fmax:4063  current:2663", b"s:1.0", b"DONE3030,0", b"6,f22", b"ERR7", b"DONE:LA"]):
        put("lens_reply", f"line{n}", line)
    talk = b"\x07s:1.0\r" + b"\x01" + b"fmin:0  fmax:9  current:5\r" * 4 + b"0,f0\r" * 4 + b"\x02fmin:0  fmax:9  current:5\r" * 2
    put("lens_reply", "talk", talk)
    put("kept", "nothing", bytes(40))
    for n, text in enumerate([b"lens.set_focus 3030", b"arm focus.run", b"solver.configure 1 20.5", b"file:/sys/a *0.001 +2",
                              b"2012-12-30--08-27-56--625_p1.fits", b"11d", b"command:/bin/echo 7", b"0123456789abcdef" * 4]):
        put("texts", f"text{n}", text)
    # The entries of a journal are in seeds, but those of the legacy dialect: a computer that connects, and its block of 34 commands.
    connects = bytes([1, 0, 5, 1])
    put("replay", "legacy", connects + bytes([2, 0, 6, 1, 34]) + (bytes([3, 2]) + struct.pack("<8d", *[1.0] * 8)) * 34 + bytes([0]))
    put("legacy", "counter", bytes([30, 0, 0]) + bytes(61) * 3)
    for source in (PROJECT / "config").glob("*.toml"):
        put("settings", source.name, source.name[:1].encode() + source.read_bytes())
    put("settings", "assignment", b"ssolver.matching.min_matched=6")
    for directory in (HERE / "seeds").iterdir():
        for source in directory.iterdir():
            put(directory.name, source.name, source.read_bytes())


if __name__ == "__main__":
    main()
