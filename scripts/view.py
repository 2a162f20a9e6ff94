#!/usr/bin/env python3
"""Puts together the packets of a thin-link view (proto/view.md). Standard library only.

    view.py PACKETS [--picture OUT.png|OUT.fits] [--thumbnail OUT.png]

PACKETS has the packets one after the other, in any order, with anything between them. Prints what they say as JSON. A PNG is levelled
to 8 bits, with its top row first; a FITS file has every value, its bottom row first. A whole frame of 1.5 megapixels takes some
ten seconds. Exits 0 if the picture is exact, 1 if packets are missing, 2 if there is nothing to show.
"""

import argparse
import datetime
import json
import struct
import sys
import zlib

MAGIC = b"sV\x01"
HEAD_BYTES, OVERHEAD = 12, 16
LONGEST = 17  # bits of a magnitude
RATE, LEAST, EVEN = 6, 64, 1 << 15
TAIL = (65536, 59017, 52598, 46377, 40441, 34863, 29705, 25007, 20795, 17078, 13848, 11084, 8757, 6826, 5251, 3984, 2982, 2201, 1602, 1150,
        814, 568, 391, 265, 177, 117, 76, 48, 30, 19, 12, 7, 4)  # fmt: skip
QUARTERS = (65536, 55109, 46341, 38968)
LEVELS, BLOCK, REACH = 4, 16, 5
CLASSES = 1 + 2 * LEVELS
FIXED = struct.Struct("<BHHHIIIIqffiBHHHII10sBB")
FIELDS = """part flags width height packets checksum image trigger utc exposure gain focus exposures full_scale low high base step
            widths bits count""".split()


def place(width, t):
    return ((2 * t - 1) * 2048 * QUARTERS[width % 4]) >> (16 + width // 4)


def tail(width, t):
    step, part = divmod(place(width, t) if t else 0, 32)
    return (TAIL[step] * (32 - part) + TAIL[step + 1] * part) // 32 if step + 1 < len(TAIL) else TAIL[-1]


def upper(width, low, middle, end=None):
    """How probable a magnitude of `middle` or more is among those from `low` and below `end`, in 2⁻¹⁶."""
    beyond = tail(width, end) if end else 0
    whole = max(0, tail(width, low) - beyond)
    if whole == 0 or low > 0 and place(width, low) >= 1024:
        return EVEN
    return min(max((max(0, tail(width, middle) - beyond) << 16) // whole, LEAST), (1 << 16) - LEAST)


def model(width):
    """The probabilities of one kind of number: LONGEST of a longer magnitude, then three for each length."""
    p = [upper(width, (1 << bits) >> 1, 1 << bits) for bits in range(LONGEST)]
    for bits in range(LONGEST + 1):
        low, end = (1 << bits) >> 1, 1 << bits
        middle = (low + end) // 2
        p.append(upper(width, low, middle, end) if bits > 1 else EVEN)
        p.append(upper(width, low, (low + middle) // 2, middle) if bits > 2 else EVEN)
        p.append(upper(width, middle, (middle + end) // 2, end) if bits > 2 else EVEN)
    return p


class Unpacker:
    """Reads the numbers of one packet."""

    def __init__(self, coded, models):
        self.low, self.high = 0, 0xFFFFFFFF
        self.bytes = iter(coded)
        self.code = 0
        for _ in range(4):
            self.code = self.code << 8 | next(self.bytes, 0)
        self.models = [list(model) for model in models]

    def bit(self, p):
        cut = self.low + ((self.high - self.low) * p >> 16)
        one = self.code <= cut
        if one:
            self.high = cut
        else:
            self.low = cut + 1
        while (self.low ^ self.high) < 1 << 24:
            self.low = self.low << 8 & 0xFFFFFFFF
            self.high = self.high << 8 & 0xFFFFFFFF | 0xFF
            self.code = self.code << 8 & 0xFFFFFFFF | next(self.bytes, 0)
        return one

    def follow(self, model, at):
        p = model[at]
        if self.bit(p):
            model[at] = p + ((1 << 16) - p >> RATE)
            return 1
        model[at] = p - (p >> RATE)
        return 0

    def number(self, kind):
        model = self.models[kind]
        bits = 0
        while bits < LONGEST and self.follow(model, bits):
            bits += 1
        if bits == 0:
            return 0
        negative = self.bit(EVEN)
        magnitude, context = 1, 0
        for depth in range(bits - 1):
            one = self.follow(model, LONGEST + 3 * bits + context) if depth < 2 else int(self.bit(EVEN))
            context = 1 + one
            magnitude = magnitude << 1 | one
        return -magnitude if negative else magnitude


def sound_packets(data):
    """(number, stream, payload) of every packet whose checksum is right."""
    at = data.find(MAGIC)
    while at >= 0:
        if at + HEAD_BYTES <= len(data):
            stream, length = struct.unpack_from("<IH", data, at + 6)
            end = at + HEAD_BYTES + length
            if end + 4 <= len(data) and zlib.crc32(data[at:end]) == struct.unpack_from("<I", data, end)[0]:
                yield int.from_bytes(data[at + 3 : at + 6], "little"), stream, data[at + HEAD_BYTES : end]
                at = data.find(MAGIC, end + 4)
                continue
        at = data.find(MAGIC, at + 1)


def read_head(payload):
    """The head as a dictionary."""
    head = dict(zip(FIELDS, FIXED.unpack_from(payload)))
    unit, flags = 1 << head["bits"], head["flags"]
    entries = struct.iter_unpack("<HHB", payload[FIXED.size :])
    head["sources"] = [{"x": x / unit, "y": y / unit, "flux": 2 ** (flux / 8)} for x, y, flux in entries]
    head["bottom_first"] = bool(flags & 1)
    for name, bit in (("trigger", 2), ("exposure", 3), ("gain", 4), ("focus", 5), ("full_scale", 6)):
        if not flags >> bit & 1:
            head[name] = None
    head["quality"] = (None, "unset", "free_running", "synchronised")[flags >> 7 & 3]
    return head


def order(width, height, sources):
    """Where each coefficient stands in the plane, and its class, in the order in which they are sent."""
    across, down = -(-width // BLOCK), -(-height // BLOCK)
    sent, found = set(), []

    def cell(x, y, level):
        step, one = 1 << level, 1 + 2 * level
        right, below = x + step < width, y + step < height
        if right:
            found.append((y * width + x + step, one))
        if below:
            found.append(((y + step) * width + x, one))
        if right and below:
            found.append(((y + step) * width + x + step, one + 1))

    for source in sources:
        x, y = min(int(source["x"]), width - 1), min(int(source["y"]), height - 1)
        for row in range(max(0, y - REACH) // BLOCK, min((y + REACH) // BLOCK + 1, down)):
            for column in range(max(0, x - REACH) // BLOCK, min((x + REACH) // BLOCK + 1, across)):
                if (column, row) in sent:
                    continue
                sent.add((column, row))
                left, top = column * BLOCK, row * BLOCK
                found.append((top * width + left, 0))
                for level in reversed(range(LEVELS)):
                    for y0 in range(top, min(height, top + BLOCK), 2 << level):
                        for x0 in range(left, min(width, left + BLOCK), 2 << level):
                            cell(x0, y0, level)
    rest = lambda x, y: (x // BLOCK, y // BLOCK) not in sent
    found += [(y * width + x, 0) for y in range(0, height, BLOCK) for x in range(0, width, BLOCK) if rest(x, y)]
    for level in reversed(range(LEVELS)):
        for y in range(0, height, 2 << level):
            for x in range(0, width, 2 << level):
                if rest(x, y):
                    cell(x, y, level)
    return found


def inverse(plane, width, height):
    """The pixels from their coefficients, in place."""
    for step in (8, 4, 2, 1):
        for y in range(0, height - step, 2 * step):
            for a in range(y * width, (y + 1) * width, step):
                b = a + step * width
                second = plane[a] - (plane[b] >> 1)
                plane[a], plane[b] = second + plane[b], second
        for y in range(0, height, step):
            for a in range(y * width, (y + 1) * width - step, 2 * step):
                b = a + step
                second = plane[a] - (plane[b] >> 1)
                plane[a], plane[b] = second + plane[b], second


class Assembly:
    """One stream as far as it has come."""

    def __init__(self, data):
        self.payloads, self.stream, self.others = {}, None, 0
        for number, stream, payload in sound_packets(data):
            if self.stream is None:
                self.stream = stream
            if stream == self.stream:
                self.payloads[number] = payload
            else:
                self.others += 1
        self.head = None
        if 0 in self.payloads and zlib.crc32(self.payloads[0]) == self.stream:
            self.head = read_head(self.payloads[0])
            self.decode()

    def decode(self):
        head = self.head
        width, height = head["width"], head["height"]
        self.across, self.down = min(width, 96), min(height, 64)
        self.cells = [None] * (self.across * self.down)
        plane = [None] * (width * height)
        places = order(width, height, head["sources"])
        models = [model(width) for width in head["widths"]]
        for number, payload in sorted(self.payloads.items()):
            if number == 0:
                continue
            part, at = payload[0], 1
            run = []
            for _ in range(2):
                value = shift = 0
                while True:
                    value |= (payload[at] & 0x7F) << shift
                    at, shift = at + 1, shift + 7
                    if payload[at - 1] < 0x80:
                        break
                run.append(value)
            first, count = run
            if part == 1:
                self.read_cells(payload[at:], first, count, models[CLASSES:])
            elif part == 2:
                unpacker = Unpacker(payload[at:], models)
                before = head["low"]
                for where, kind in places[first : first + count]:
                    value = unpacker.number(kind)
                    if kind == 0:
                        value = before = min(max(before + value, 0), 0xFFFF)
                    plane[where] = value
        self.missing = [n for n in range(head["packets"]) if n not in self.payloads]
        for y in range(height):
            for x in range(width):
                if plane[y * width + x] is None:
                    plane[y * width + x] = 0 if x % BLOCK or y % BLOCK else self.guess(x, y)
        inverse(plane, width, height)
        self.pixels = [min(max(value, 0), 0xFFFF) for value in plane]
        checksum = zlib.crc32(struct.pack(f"<{len(self.pixels)}H", *self.pixels))
        self.exact = not self.missing and checksum == head["checksum"]

    def read_cells(self, coded, first, count, models):
        unpacker, across, cells = Unpacker(coded, models), self.across, self.cells
        for at in range(first, first + count):
            x = at % across
            near = [at - across] + ([at - 1, at - across - 1] if x else []) + ([at - across + 1] if x + 1 < across else [])
            values = [cells[n] for n in near if first <= n < at]
            if len(values) == 4:
                expected = (sum(values) - min(values) - max(values) + 1) // 2
            else:
                expected = (sum(values) + len(values) // 2) // len(values) if values else 0
            cells[at] = min(max(expected + unpacker.number(0), 0), 0xFFFF)

    def guess(self, left, top):
        """The mean of a block that has not come, from the thumbnail."""
        head = self.head
        x, y = min(left + BLOCK // 2, head["width"] - 1), min(top + BLOCK // 2, head["height"] - 1)
        column = -(-(x + 1) * self.across // head["width"]) - 1
        row = -(-(y + 1) * self.down // head["height"]) - 1
        cell = self.cells[row * self.across + column]
        return (head["low"] + head["high"]) // 2 if cell is None else min((head["base"] + cell * head["step"]) // 16, 0xFFFF)


def rows(pixels, width, flip):
    lines = [pixels[at : at + width] for at in range(0, len(pixels), width)]
    return lines[::-1] if flip else lines


def write_png(path, pixels, width, bottom_first, low, high):
    """Grey in 8 bits between two levels."""
    shade = lambda value: min(max((value - low) * 255 // max(1, high - low), 0), 255)
    lines = rows(pixels, width, bottom_first)
    raw = b"".join(b"\0" + bytes(shade(value) for value in line) for line in lines)
    chunk = lambda kind, data: struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    head = struct.pack(">IIBBBBB", width, len(lines), 8, 0, 0, 0, 0)
    with open(path, "wb") as out:
        out.write(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(raw)) + chunk(b"IEND", b""))


def write_fits(path, pixels, width, bottom_first):
    """Every value, as FITS keeps 16 bits without sign."""
    lines = rows(pixels, width, not bottom_first)
    cards = {"SIMPLE": "T", "BITPIX": 16, "NAXIS": 2, "NAXIS1": width, "NAXIS2": len(lines), "BZERO": 32768, "BSCALE": 1}
    header = "".join(f"{key:<8}= {value:>20}".ljust(80) for key, value in cards.items()) + "END".ljust(80)
    data = b"".join(struct.pack(f">{width}h", *(value - 32768 for value in line)) for line in lines)
    with open(path, "wb") as out:
        out.write(header.ljust(-(-len(header) // 2880) * 2880).encode() + data.ljust(-(-len(data) // 2880) * 2880, b"\0"))


def ranges(numbers):
    """Numbers in rising order as pairs of first and last."""
    found = []
    for number in numbers:
        if found and found[-1][1] == number - 1:
            found[-1][1] = number
        else:
            found.append([number, number])
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("packets")
    parser.add_argument("--picture")
    parser.add_argument("--thumbnail")
    args = parser.parse_args()
    with open(args.packets, "rb") as file:
        assembly = Assembly(file.read())
    head = assembly.head
    if head is None:
        print(f"view.py: {args.packets}: packet 0 is missing, {len(assembly.payloads)} others are there", file=sys.stderr)
        return 2
    known = {name: head[name] for name in ("width", "height", "packets", "image", "trigger", "exposure", "gain", "focus", "exposures",
                                           "full_scale", "low", "high", "quality", "sources")}  # fmt: skip
    if head["quality"]:
        epoch = datetime.datetime(1970, 1, 1)
        known["utc"] = (epoch + datetime.timedelta(microseconds=head["utc"])).isoformat()
    known |= {"come": len(assembly.payloads), "missing": ranges(assembly.missing), "other_streams": assembly.others}
    known["exact"] = assembly.exact
    print(json.dumps(known, indent=1))
    if args.picture and args.picture.endswith(".fits"):
        write_fits(args.picture, assembly.pixels, head["width"], head["bottom_first"])
    elif args.picture:
        write_png(args.picture, assembly.pixels, head["width"], head["bottom_first"], head["low"], head["high"])
    if args.thumbnail:
        come = sorted(cell for cell in assembly.cells if cell is not None) or [0]
        cells = [come[len(come) // 2] if cell is None else cell for cell in assembly.cells]
        # The middle 98 %, as the program levels.
        low, high = come[len(come) // 100], come[-1 - len(come) // 100]
        write_png(args.thumbnail, cells, assembly.across, head["bottom_first"], low, high)
    return 0 if assembly.exact else 1


if __name__ == "__main__":
    sys.exit(main())
