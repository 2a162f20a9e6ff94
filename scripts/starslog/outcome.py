"""What the star camera says of an image: one line of its log as an object.

Attributes have the names of the log's keys, with their units: degrees, arcseconds, pixels, milliseconds, ADU. Pixel (0, 0) is the
centre of the file's first pixel, x is the column and y the row in the order of the file. What is not known is None.
"""

import math
import re
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from statistics import median
from typing import NamedTuple

from .record import NOT_JSON, Record, WrongShape

NotAnOutcome = WrongShape
BOOT_IN_NAME = re.compile(r"-([0-9a-f]{8})\.jsonl$")


@dataclass(kw_only=True, slots=True)
class Observer(Record):
    """Where the observer stands and how far the sky has turned."""

    latitude_deg: float | None = None
    # Local sidereal time, h.
    sidereal_time_h: float | None = None


@dataclass(kw_only=True, slots=True)
class Candidate(Record):
    """The best pointing that was found but not served."""

    ra_deg: float | None = None
    dec_deg: float | None = None
    roll_deg: float | None = None
    platescale_arcsec_px: float | None = None
    matched: int = 0
    rms_px: float | None = None
    false_probability_log10: float | None = None


@dataclass(kw_only=True, slots=True)
class AttitudePrior(Record):
    """The attitude that was expected, one σ of it per axis and in roll."""

    ra_deg: float | None = None
    dec_deg: float | None = None
    roll_deg: float | None = None
    sigma_deg: float | None = None
    sigma_roll_deg: float | None = None


@dataclass(kw_only=True, slots=True)
class Prior(Record):
    """What was known before the image was solved."""

    az_deg: float | None = None
    el_deg: float | None = None
    ra_deg: float | None = None
    dec_deg: float | None = None
    observer: Observer | None = None
    attitude: AttitudePrior | None = None
    platescale_arcsec_px: float | None = None
    sigma_platescale_arcsec_px: float | None = None


@dataclass(kw_only=True, slots=True)
class Statistics(Record):
    """Statistics of the image; all None where it was not looked at."""

    # Mean of the cells' means, and median of their standard deviations, ADU.
    mean: float | None = None
    noise: float | None = None
    # Measured gain, ADU/e⁻.
    gain: float | None = None
    saturated_px: int | None = None
    saturated_fraction: float | None = None
    # Median full width at half maximum of the better sources, px.
    fwhm_px: float | None = None
    # Lower and upper end of the displayed range, ADU.
    level: list[int] | None = None


@dataclass(kw_only=True, slots=True)
class Star(Record):
    """A star of the catalogue. Its place is ICRS, at the epoch that the stars were moved to."""

    # Its place in the catalogue, brightest first.
    id: int
    # Proper name, else `HIP n`, else `G<id>`.
    name: str = ""
    ra_deg: float | None = None
    dec_deg: float | None = None
    # Gaia RP magnitude.
    mag: float | None = None
    # Distance between the source and where the fit has the star, px.
    residual_px: float | None = None


@dataclass(kw_only=True, slots=True)
class Source(Record):
    """A source in the image, and the star that it is."""

    # Its place in the list, from 0, brightest first.
    id: int
    x: float | None = None
    y: float | None = None
    # One σ of the centroid per axis that photon noise gives.
    sigma_px: float | None = None
    # Flux above the surroundings, ADU.
    flux: float | None = None
    # Matched-filter signal over noise.
    snr: float | None = None
    # Highest pixel above the surroundings, ADU.
    peak: float | None = None
    saturated: bool = False
    # The star that it was matched to; None where it was not.
    star: Star | None = None


@dataclass(kw_only=True, slots=True)
class SeriesStart(Record):
    """The pointing at the start of a series of exposures, ICRS."""

    ra_deg: float | None = None
    dec_deg: float | None = None
    roll_deg: float | None = None
    sigma_east_arcsec: float | None = None
    sigma_north_arcsec: float | None = None
    # From there to the middle of the light, s.
    before_middle_s: float | None = None


@dataclass(kw_only=True, slots=True)
class Times(Record):
    """How long each stage took, ms. All 0 where the program ran on a simulated clock."""

    read: float | None = None
    statistics: float | None = None
    find: float | None = None
    match: float | None = None
    fit: float | None = None
    total: float | None = None


class Photometry(NamedTuple):
    """How bright the matched stars are in the image."""

    # Magnitude of a star that gives 1 ADU in this exposure.
    zero_point_mag: float
    # Stars that it is the median of.
    fitted: int
    # Matched stars that were left out: saturated, or without a flux.
    ignored: int


@dataclass(kw_only=True, slots=True)
class Solution(Record):
    """What came of an image, solved or not."""

    # Where the image came from: the path as given, or what the camera calls it.
    image: str
    image_counter: int | None = None
    trigger_counter: int | None = None
    # What made the camera expose: asked (nobody triggers it), trigger, or itself for want of one.
    exposed_by: str | None = None
    # Middle of the exposure, ISO 8601, as written; `captured` is the same as a datetime.
    captured_utc: str | None = None
    # How far that time can be believed: unset, free_running, synchronised, flight_computer, chrony or ptp; and one σ of it, s.
    clock: str | None = None
    captured_sigma_s: float | None = None
    # The same middle since the program's start, on a clock that never jumps, s.
    captured_uptime_s: float | None = None
    simulated: bool | None = None
    missing_packets: int | None = None
    missed_frames: int | None = None
    # Of one exposure; gain of the camera.
    exposure_s: float | None = None
    gain_db: float | None = None
    # Encoder counts, where the lens stood still for the image; an aperture of 0 is open.
    focus_counts: int | None = None
    aperture_counts: int | None = None
    # Which end of the picture the first row is, from which the rows of sources are counted: bottom_first or top_first.
    row_order: str | None = None
    # Of the camera, as it tells it itself, and of the lens, °C.
    temperature_camera_c: float | None = None
    temperature_lens_c: float | None = None
    # Whether there is a pointing.
    solved: bool
    # How the image ended: solved, no_match, …
    reason: str
    # What the image's own evidence says was wrong: out_of_focus, trailed, clouds, …
    cause: str | None = None
    # Diameter of the discs, or length and direction (from x towards y) of the trails, that stars are.
    blur_px: float | None = None
    blur_angle_deg: float | None = None
    # The reason in words.
    detail: str = ""
    # How sources were searched for: normal or robust.
    mode: str | None = None
    # How the pointing was found: tracked or lost_in_space.
    search: str | None = None
    # The boresight, ICRS, or of date where `equatorial_equinox_yr` says so.
    ra_deg: float | None = None
    dec_deg: float | None = None
    # Position angle of the picture's up direction, from North through East.
    roll_deg: float | None = None
    # Azimuth from north through east, and elevation.
    az_deg: float | None = None
    el_deg: float | None = None
    # Angle of the picture's up direction from the zenith, positive towards growing azimuth.
    horizontal_roll_deg: float | None = None
    # At the centre of the picture.
    platescale_arcsec_px: float | None = None
    sigma_platescale_arcsec_px: float | None = None
    # Radial distortion at the half diagonal.
    distortion_k1: float | None = None
    # One σ of the boresight towards East and North, and of the roll.
    sigma_east_arcsec: float | None = None
    sigma_north_arcsec: float | None = None
    sigma_roll_arcsec: float | None = None
    # One σ along growing azimuth, on the sky, and along elevation.
    sigma_az_arcsec: float | None = None
    sigma_el_arcsec: float | None = None
    # Of east, north and roll.
    covariance_arcsec2: list[list[float]] | None = None
    # Root mean square of the residuals per axis.
    rms_px: float | None = None
    chi2_per_dof: float | None = None
    # Upper bound on the probability that this solution is false.
    false_probability_log10: float | None = None
    # Epoch that the stars were moved to, Julian year.
    epoch_yr: float | None = None
    # Equinox of right ascension, declination and roll, Julian year; None for ICRS.
    equatorial_equinox_yr: float | None = None
    # Equinox that azimuth and elevation were computed with, Julian year; None for ICRS axes.
    equinox_yr: float | None = None
    # The observer that azimuth and elevation were computed for.
    observer: Observer | None = None
    # The pointing at the start of a series whose motion is known; that above is then of the middle of its light.
    series_start: SeriesStart | None = None
    # Sources that were matched, found, and made patterns of; candidate attitudes that were screened.
    matched: int = 0
    sources_found: int = 0
    sources_tried: int = 0
    candidates_tried: int = 0
    candidate: Candidate | None = None
    prior: Prior | None = None
    # How far the pointing lies from a prior that turned out wrong.
    prior_disagreement_deg: float | None = None
    stats: Statistics | None = None
    # Brightest first.
    sources: list[Source] = field(default_factory=list)
    # The last triangles tried, as ids of sources.
    triangles: list[list[int]] = field(default_factory=list)
    time_ms: Times | None = None
    # What is in the pointing: proper_motion, aberration, precession, refraction, distortion.
    corrections: list[str] = field(default_factory=list)

    # The JSON object as it was read.
    raw: dict | None = field(default=None, repr=False, compare=False, metadata=NOT_JSON)
    # The log that it was read from, and the number of the line from 1.
    log: Path | None = field(default=None, repr=False, compare=False, metadata=NOT_JSON)
    line: int | None = field(default=None, repr=False, compare=False, metadata=NOT_JSON)

    @property
    def captured(self) -> datetime | None:
        """Middle of the exposure, UTC; None where it is not known."""
        try:
            time = datetime.fromisoformat(self.captured_utc) if self.captured_utc else None
        except ValueError:
            return None
        return time and (time.replace(tzinfo=UTC) if time.tzinfo is None else time.astimezone(UTC))

    @property
    def boot(self) -> int | None:
        """Number of the start of the program, from the name of the log; an image is known by it and its counter."""
        found = self.log and BOOT_IN_NAME.search(self.log.name)
        return int(found[1], 16) if found else None

    @property
    def matches(self) -> list[tuple[Source, Star]]:
        """Sources and the stars that they are."""
        return [(source, source.star) for source in self.sources if source.star]

    @property
    def pointing_error_arcsec(self) -> float | None:
        """One σ of the boresight, mean of its two axes."""
        if self.sigma_east_arcsec is None or self.sigma_north_arcsec is None:
            return None
        return 0.5 * (self.sigma_east_arcsec + self.sigma_north_arcsec)

    @property
    def place(self) -> Observer | None:
        """The observer: the one that was used, else the one that was known."""
        return self.observer or (self.prior and self.prior.observer)

    def photometry(self) -> Photometry | None:
        """Zero point of the matched stars' fluxes; None without one that counts.

        With the exposure of the image it gives the light that reaches the sensor; without it, how that changes.
        """
        matches = self.matches
        points = [star.mag + 2.5 * math.log10(source.flux) for source, star in matches if counts(source, star)]
        return Photometry(median(points), len(points), len(matches) - len(points)) if points else None

    def fitted_positions(
        self, width_px: int = 1536, height_px: int = 1024, top_first: bool = False, mirrored: bool = False,
    ) -> dict[int, tuple[float, float]]:
        """Where the fit has each matched star: x, y by the id of its source, px in file order.

        The log does not know the format of the image: `top_first` for files whose first row is the top one, `mirrored` for optics
        that turn the picture over. Nor does it know all that the program fits, as the place of the lens's axis: distances from
        the sources agree with `residual_px`, as logged, to 0.01 px in the median, but to 0.3 px for one star in a hundred.
        Empty where the pointing is of date or has aberration in it, which the stars' places have not.
        """
        if not self.solved or self.equatorial_equinox_yr is not None or "aberration" in self.corrections:
            return {}
        left, up, boresight = axes(self.ra_deg, self.dec_deg, self.roll_deg)
        scale = math.radians(self.platescale_arcsec_px / 3600)
        half_diagonal = 0.5 * math.hypot(width_px, height_px)
        positions = {}
        for source, star in self.matches:
            direction = unit(star.ra_deg, star.dec_deg)
            depth = dot(direction, boresight)
            u, v = dot(direction, left) / depth / scale, dot(direction, up) / depth / scale
            stretch = 1 + (self.distortion_k1 or 0.0) * (u * u + v * v) / half_diagonal**2
            right, above = stretch * (u if mirrored else -u), stretch * (-v if top_first else v)
            positions[source.id] = (0.5 * (width_px - 1) + right, 0.5 * (height_px - 1) + above)
        return positions


def counts(source, star):
    """Whether a matched star's flux says something."""
    return not source.saturated and star.mag is not None and (source.flux or 0.0) > 0.0


def dot(a, b):
    """Scalar product."""
    return sum(x * y for x, y in zip(a, b))


def unit(ra_deg, dec_deg):
    """Unit vector of a direction."""
    ra, dec = math.radians(ra_deg), math.radians(dec_deg)
    return (math.cos(dec) * math.cos(ra), math.cos(dec) * math.sin(ra), math.sin(dec))


def axes(ra_deg, dec_deg, roll_deg):
    """Unit vectors on the sky of the picture's left, its up direction and the boresight: the attitude."""
    boresight, east, north = unit(ra_deg, dec_deg), unit(ra_deg + 90, 0), unit(ra_deg, dec_deg + 90)
    sin, cos = math.sin(math.radians(roll_deg)), math.cos(math.radians(roll_deg))
    left = tuple(e * cos - n * sin for e, n in zip(east, north))
    up = tuple(e * sin + n * cos for e, n in zip(east, north))
    return left, up, boresight
