"""What the plots and the summary show, as numbers. Standard library only."""

import csv
import json
import math
from bisect import bisect_left
from collections import Counter
from datetime import UTC, datetime
from pathlib import Path
from statistics import median
from typing import NamedTuple

from .logs import LogError
from .outcome import axes, dot, unit

ARCSEC_PER_DEG = 3600.0
TRUTH_SUFFIX = ".truth.json"
IMAGE_SUFFIXES = (".fits", ".fit", ".fts", ".tiff", ".tif", ".png", ".jpeg", ".jpg")
# Solutions further apart than this say little of each other, s.
NEIGHBOURS_S = 5.0
# The log has times to the millisecond, s.
TIME_SIGMA_S = 1e-3 / math.sqrt(12)
# Plate scales are compared with the median of so many of their neighbours on each side.
NEIGHBOURS = 10
TEMPERATURE_KEYWORDS = ("LENSTEMP", "CCD-TEMP", "TEMPERAT", "TEMP")


class Sigmas(NamedTuple):
    """Errors, or differences, over their σ."""

    east: list[float]
    north: list[float]
    roll: list[float]


def median_of(values):
    """The median of the values that are there; None of none."""
    values = [value for value in values if value is not None]
    return median(values) if values else None


def ending(solution):
    """How an image ended, and what was wrong with it, in words."""
    return solution.reason + (f" ({solution.cause})" if solution.cause else "")


def endings(solutions):
    """How often images ended in which way, most frequent first."""
    return Counter(map(ending, solutions)).most_common()


def timed(solutions):
    """Solutions whose time is known, and that time."""
    return [(solution.captured, solution) for solution in solutions if solution.captured]


def intervals_s(solutions):
    """Times from one image of a log to the next, s, each after the time of the later image.

    Steps of the clock, back or over a day, are left out.
    """
    found = []
    for before, after in zip(solutions, solutions[1:]):
        if before.log == after.log and before.captured and after.captured:
            step = (after.captured - before.captured).total_seconds()
            if 0 < step < 86_400:
                found.append((after.captured, step))
    return found


def has_solve_times(solutions):
    """Whether the program's clock ran while it solved; a simulated one stands still."""
    return any(solution.time_ms and solution.time_ms.total for solution in solutions)


def residuals_in_sigma(solutions):
    """Distances between matched sources and their stars over the σ per axis of the centroid."""
    return [
        star.residual_px / source.sigma_px
        for solution in solutions
        for source, star in solution.matches
        if star.residual_px is not None and source.sigma_px
    ]


def platescale_steps(solutions):
    """Plate scales less the median of their neighbours', over σ: the lens changes slowly, so this is how well it repeats."""
    scales = [s for s in solutions if s.platescale_arcsec_px and s.sigma_platescale_arcsec_px]
    steps = []
    for i, solution in enumerate(scales):
        around = scales[max(0, i - NEIGHBOURS) : i] + scales[i + 1 : i + 1 + NEIGHBOURS]
        around = [other.platescale_arcsec_px for other in around if other.log == solution.log]
        if len(around) >= NEIGHBOURS:
            steps.append((solution.platescale_arcsec_px - median(around)) / solution.sigma_platescale_arcsec_px)
    return steps


def repeatability(solutions):
    """How far each solution lies from the even turn that takes the one before to the one after, over the σ of all three.

    Without a truth this tells honest σ from others where the camera turns evenly; where it does not, the motion is in it too.
    """
    sigmas = Sigmas([], [], [])
    for before, now, after in zip(solutions, solutions[1:], solutions[2:]):
        if not (before.solved and now.solved and after.solved and before.log == after.log):
            continue
        times = [solution.captured for solution in (before, now, after)]
        if None in times or now.equatorial_equinox_yr != before.equatorial_equinox_yr:
            continue
        first, second = (times[1] - times[0]).total_seconds(), (times[2] - times[1]).total_seconds()
        if not (0 < first <= NEIGHBOURS_S and 0 < second <= NEIGHBOURS_S):
            continue
        part = first / (first + second)
        expected = turned(attitude(before), attitude(after), part)
        moved = differences(attitude(after), attitude(before))
        for into, difference, way, name in zip(sigmas, differences(attitude(now), expected), moved, Sigmas._fields):
            parts = [getattr(solution, f"sigma_{name}_arcsec") for solution in (before, now, after)]
            if all(parts):
                speed = way / (first + second)
                shares = [math.hypot(sigma, speed * TIME_SIGMA_S) for sigma in parts]
                into.append(difference / math.hypot((1 - part) * shares[0], shares[1], part * shares[2]))
    return sigmas


def attitude(solution):
    """Left, up and boresight of a solution."""
    return axes(solution.ra_deg, solution.dec_deg, solution.roll_deg)


def turned(start, end, part):
    """The attitude after a part of the one turn that takes `start` to `end`."""
    # The turn's axis and angle, from the matrix that takes the axes of the one to those of the other.
    m = [[sum(e[i] * s[j] for s, e in zip(start, end)) for j in range(3)] for i in range(3)]
    twice = (m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1])
    sine = 0.5 * math.hypot(*twice)
    if sine < 1e-15:
        return start
    angle = part * math.atan2(sine, 0.5 * (m[0][0] + m[1][1] + m[2][2] - 1))
    axis = [component / (2 * sine) for component in twice]
    return tuple(turned_about(axis, angle, vector) for vector in start)


def turned_about(axis, angle, v):
    """A vector turned about an axis."""
    cos, sin, along = math.cos(angle), math.sin(angle), dot(axis, v) * (1 - math.cos(angle))
    cross = (axis[1] * v[2] - axis[2] * v[1], axis[2] * v[0] - axis[0] * v[2], axis[0] * v[1] - axis[1] * v[0])
    return tuple(cos * v[i] + sin * cross[i] + along * axis[i] for i in range(3))


def differences(got, expected):
    """One attitude less another near it: towards east, north, and in roll (position angle), arcsec."""
    _, up, boresight = expected
    ra, dec = math.atan2(boresight[1], boresight[0]), math.asin(max(-1.0, min(1.0, boresight[2])))
    east, north = unit(math.degrees(ra) + 90, 0), unit(math.degrees(ra), math.degrees(dec) + 90)
    arcsec = math.degrees(1) * ARCSEC_PER_DEG
    return dot(got[2], east) * arcsec, dot(got[2], north) * arcsec, roll_between(got, expected[0], up) * arcsec


def roll_between(got, left, up):
    """Position angle of an attitude's up direction from another's, rad; positive from North through East, which is left."""
    return math.atan2(dot(got[1], left), dot(got[1], up))


def read_truth(path):
    """True pointings by the name of the image.

    Of a directory of NAME.truth.json, as `stars render` writes them, or of a file of JSON objects, one a line, with `image`,
    `ra_deg`, `dec_deg` and `roll_deg`. An image of no stars is left out.
    """
    path = Path(path)
    try:
        if path.is_dir():
            found = {file.name.removesuffix(TRUTH_SUFFIX): json.loads(file.read_text()) for file in path.glob("*" + TRUTH_SUFFIX)}
        else:
            found = {stem(truth["image"]): truth for truth in map(json.loads, filter(str.strip, path.read_text().split("\n")))}
        truths = {
            name: {key: float(truth[key]) for key in ("ra_deg", "dec_deg", "roll_deg")}
            for name, truth in found.items()
            if truth.get("ra_deg") is not None
        }
    except OSError as error:
        raise LogError(f"{path}: {error.strerror}") from error
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise LogError(f"{path}: not a truth file: {type(error).__name__} {error}") from error
    if not truths:
        raise LogError(f"{path}: there is no truth here")
    return truths


def stem(image):
    """Name of an image without its directory and the ending of its file."""
    name = Path(image).name
    return next((name[: -len(end)] for end in IMAGE_SUFFIXES if name.lower().endswith(end)), name)


def errors_in_sigma(solutions, truths):
    """Errors of the solutions whose truth is known, over their own σ."""
    sigmas = Sigmas([], [], [])
    for solution in solutions:
        truth = truths.get(stem(solution.image))
        if truth and solution.solved:
            true = axes(truth["ra_deg"], truth["dec_deg"], truth["roll_deg"])
            for into, error, name in zip(sigmas, differences(attitude(solution), true), Sigmas._fields):
                if sigma := getattr(solution, f"sigma_{name}_arcsec"):
                    into.append(error / sigma)
    return sigmas


def shares_within(values):
    """Share of values within 1, 2 and 3, percent."""
    return [100 * sum(abs(v) <= k for v in values) / len(values) for k in (1, 2, 3)]


def read_temperatures(path):
    """Times and temperatures of a table `utc,celsius` without a header, in order of time."""
    try:
        with Path(path).open(newline="") as file:
            rows = [row for row in csv.reader(file) if row and not row[0].startswith("#")]
        return sorted((utc(time), float(celsius)) for time, celsius, *_ in rows)
    except OSError as error:
        raise LogError(f"{path}: {error.strerror}") from error
    except ValueError as error:
        raise LogError(f"{path}: not a table of utc,celsius: {error}") from error


def utc(text):
    """A time from ISO 8601; UTC where it has no zone."""
    time = datetime.fromisoformat(text.strip())
    return time.replace(tzinfo=UTC) if time.tzinfo is None else time.astimezone(UTC)


def focus_of(solution, header):
    """Focus of the lens, counts, from the log where it has it, else from the header of the image."""
    return number_of(solution.focus_counts, header.get("FOCUS"))


def temperature_of(solution, header):
    """The lens's temperature, °C, else the camera's: from the log where it has one, else from the header of the image."""
    in_log = (solution.temperature_lens_c, solution.temperature_camera_c)
    return number_of(*in_log, *(header.get(keyword) for keyword in TEMPERATURE_KEYWORDS))


def number_of(*values):
    """The first that is a number."""
    return next((value for value in values if isinstance(value, (int, float)) and not isinstance(value, bool)), None)


def nearest(table, time, within_s=600.0):
    """The value of a table of times and values that is nearest in time; None where all are further away."""
    at = bisect_left(table, (time,))
    near = min(table[max(0, at - 1) : at + 1], key=lambda row: abs(row[0] - time), default=None)
    return near[1] if near and abs((near[0] - time).total_seconds()) <= within_s else None
