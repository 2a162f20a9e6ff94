"""Plots of a log. Needs matplotlib."""

import math
from statistics import NormalDist, quantiles
from typing import NamedTuple

from . import analysis
from .fits import header_of
from .needs import need

# Values in σ are drawn so far; what lies beyond is counted in words.
MOST_SIGMAS = 6.0
BINS = 48
# A curve of shares has so many steps at least, where there are the images for it.
SHARE_STEPS = 40
GREY = "0.35"


class Beside(NamedTuple):
    """What a plot may take besides the log; None where it was not given."""

    truths: dict | None = None
    images: dict | None = None
    temperatures: list | None = None


class NothingToPlot(ValueError):
    """The log has none of what the plot shows."""


def draw(what, solutions, path, beside=Beside()):
    """Draws one of PLOTS into a file, whose ending says its format."""
    figure = need("matplotlib.figure", "a plot").Figure(figsize=(11, 8), layout="constrained")
    PLOTS[what](figure, solutions, beside)
    figure.savefig(path, dpi=120)


def residuals(figure, solutions, beside):
    """Residuals of the matched stars: how they are spread, against magnitude, over the picture, and over time."""
    matches = [(source, star) for s in solutions for source, star in s.matches if star.residual_px is not None]
    if not matches:
        raise NothingToPlot("no image has a matched star")
    (spread, magnitude), (picture, time) = figure.subplots(2, 2)
    distances = [star.residual_px for _, star in matches]
    spread.hist(distances, bins=BINS, range=(0, max(distances) or 1.0))
    label(spread, "residual, px", "stars", f"{len(distances)} matched stars, median {analysis.median_of(distances):.3f} px")
    bright = [(star.mag, star.residual_px) for _, star in matches if star.mag is not None]
    magnitude.plot(*zip(*bright), ".", ms=2, alpha=0.3) if bright else unknown(magnitude)
    label(magnitude, "Gaia RP magnitude", "residual, px")
    places = [(source.x, source.y, star.residual_px) for source, star in matches if None not in (source.x, source.y)]
    if places:
        x, y, value = zip(*places)
        cells = picture.hexbin(x, y, C=value, gridsize=16, reduce_C_function=analysis.median_of)
        figure.colorbar(cells, ax=picture, label="median residual, px")
    label(picture, "x, px", "y, px")
    over_time(time, solutions, lambda s: s.rms_px, "rms of the residuals per axis, px")


def coverage(figure, solutions, beside):
    """Whether σ are honest: of the centroids, of the fit, of the attitude."""
    solved = [s for s in solutions if s.solved]
    if not solved:
        raise NothingToPlot("no image was solved")
    (stars, fit), (attitude, scale) = figure.subplots(2, 2)
    of_stars = analysis.residuals_in_sigma(solved)
    density(stars, of_stars, lambda r: r * math.exp(-0.5 * r * r), (0, MOST_SIGMAS), "honest σ (Rayleigh)")
    label(stars, "residual / σ of the centroid from photon noise alone", "density", words(of_stars, "wanted 39/86/99"))
    chi2 = [s.chi2_per_dof for s in solved if s.chi2_per_dof is not None]
    fit.hist(chi2, bins=BINS, range=(0, max(3.0, *quantiles(chi2, n=100)[-1:])) if len(chi2) > 1 else None)
    fit.axvline(1.0, color=GREY, lw=1)
    mean = f"mean {sum(chi2) / len(chi2):.3f}, median {analysis.median_of(chi2):.3f}" if chi2 else "none"
    label(fit, "χ² over the degrees of freedom", "images", mean)
    if beside.truths is None:
        of_attitude, title = analysis.repeatability(solutions), "less the even turn between its neighbours, over σ"
    else:
        of_attitude, title = analysis.errors_in_sigma(solved, beside.truths), "less the truth, over σ"
        if not of_attitude.east:
            raise NothingToPlot("no solved image has its name in the truth")
    colours = ("C0", "C1", "C2")
    for name, values, colour in zip(of_attitude._fields, of_attitude, colours):
        text = f"{name}: {words(values)}"
        shown = [v for v in values if abs(v) <= MOST_SIGMAS]
        weights = [BINS / (2 * MOST_SIGMAS * len(values))] * len(shown) if values else None
        limits = (-MOST_SIGMAS, MOST_SIGMAS)
        attitude.hist(shown, bins=BINS, range=limits, weights=weights, histtype="step", color=colour, label=text)
    normal_curve(attitude)
    attitude.legend(fontsize="small")
    label(attitude, f"attitude {title}", "density", "wanted 68/95/99.7 % within 1/2/3 σ")
    steps = analysis.platescale_steps(solutions)
    density(scale, steps, NormalDist().pdf, (-MOST_SIGMAS, MOST_SIGMAS), "honest σ (normal)")
    label(scale, "plate scale less its neighbours' median, over σ", "density", words(steps, "wanted 68/95/99.7"))


def timing(figure, solutions, beside):
    """Where the time went; where the program's clock stood still, the time from image to image."""
    if not analysis.has_solve_times(solutions):
        steps = analysis.intervals_s(solutions)
        if not steps:
            raise NothingToPlot("the log has neither times of solving nor two images with a time")
        spread, time = figure.subplots(2, 1)
        values = [step for _, step in steps]
        spread.hist(values, bins=BINS, log=True)
        label(spread, "time since the image before, s", "images", f"median {analysis.median_of(values):.3f} s")
        time.plot(*zip(*steps), ".", ms=2)
        label(time, "UTC", "time since the image before, s")
        figure.suptitle("The log has no times of solving (a simulated clock): times between images instead")
        return
    stages, share, time = figure.subplots(3, 1)
    names = ("read", "statistics", "find", "match", "fit", "total")
    values = [[v for s in solutions if s.time_ms and (v := getattr(s.time_ms, name)) is not None] for name in names]
    stages.boxplot(values, whis=(1, 99), showfliers=False)
    stages.set_xticks(range(1, len(names) + 1), names)
    stages.set_yscale("symlog", linthresh=0.01)
    label(stages, "", "ms", "median, quartiles, and 1 to 99 % of the images; reading is not in the total")
    total = sorted(values[-1])
    share.plot(total, [100 * (i + 1) / len(total) for i in range(len(total))])
    share.set_xscale("log")
    label(share, "total, ms", "images within, %", f"median {analysis.median_of(total):.2f} ms, longest {total[-1]:.1f} ms")
    over_time(time, solutions, lambda s: s.time_ms and s.time_ms.total, "total, ms")


def reasons(figure, solutions, beside):
    """How images ended, and the share of the solved ones over time."""
    bars, time = figure.subplots(2, 1)
    endings = [(name, n) for name, n in analysis.endings(solutions) if name != "solved"]
    solved = sum(s.solved for s in solutions)
    if endings:
        names, counts = zip(*reversed(endings))
        drawn = bars.barh(names, counts)
        bars.bar_label(drawn, padding=3)
    label(bars, "images", "", f"{solved} of {len(solutions)} images solved ({100 * solved / len(solutions):.1f} %); the others")
    timed = sorted(analysis.timed(solutions), key=lambda pair: pair[0])
    step = max(10, len(timed) // SHARE_STEPS)
    parts = [timed[i : i + step] for i in range(0, len(timed), step)]
    shares = [(part[len(part) // 2][0], 100 * sum(s.solved for _, s in part) / len(part)) for part in parts]
    time.plot(*zip(*shares), ".-") if shares else unknown(time)
    label(time, "UTC", f"solved, % of {step} images")


def focus(figure, solutions, beside):
    """Focus and temperature over time and against each other, and what the width of the stars makes of both."""
    rows = []
    for solution in solutions:
        header = header_of(solution, beside.images or {})
        celsius = analysis.temperature_of(solution, header)
        if celsius is None and beside.temperatures and solution.captured:
            celsius = analysis.nearest(beside.temperatures, solution.captured)
        width = solution.stats and solution.stats.fwhm_px
        rows.append((solution.captured, width, analysis.focus_of(solution, header), celsius))
    if not any(width for _, width, _, _ in rows):
        raise NothingToPlot("no image has the width of its stars")
    (time, against_focus), (focus_time, against_temperature), (temperature_time, focus_temperature) = figure.subplots(3, 2)
    panels = (
        (time, 0, 1, "UTC", "FWHM, px"),
        (against_focus, 2, 1, "focus, counts", "FWHM, px"),
        (focus_time, 0, 2, "UTC", "focus, counts"),
        (against_temperature, 3, 1, "temperature, °C", "FWHM, px"),
        (temperature_time, 0, 3, "UTC", "temperature, °C"),
        (focus_temperature, 3, 2, "temperature, °C", "focus, counts"),
    )
    for panel, i, j, across, up in panels:
        points = [(row[i], row[j]) for row in rows if row[i] is not None and row[j] is not None]
        panel.plot(*zip(*points), ".", ms=3) if points else unknown(panel)
        label(panel, across, up, f"{len(points)} of {len(rows)} images")


PLOTS = {"residuals": residuals, "coverage": coverage, "timing": timing, "reasons": reasons, "focus": focus}


def label(panel, across, up, title=""):
    """Names the axes."""
    panel.set_xlabel(across)
    panel.set_ylabel(up)
    panel.set_title(title, fontsize="medium")
    if across == "UTC":
        panel.tick_params(axis="x", rotation=20)


def unknown(panel):
    """Says that there is nothing."""
    panel.text(0.5, 0.5, "not known", ha="center", va="center", color=GREY, transform=panel.transAxes)


def over_time(panel, solutions, value, name):
    """A value of each image over time."""
    points = [(time, v) for time, solution in analysis.timed(solutions) if (v := value(solution)) is not None]
    panel.plot(*zip(*points), ".", ms=2) if points else unknown(panel)
    label(panel, "UTC", name)


def density(panel, values, curve, limits, name):
    """A histogram beside the distribution that it should have; values beyond the limits count, but are not drawn."""
    low, high = limits
    shown = [v for v in values if low <= v <= high]
    if values:
        panel.hist(shown, bins=BINS, range=limits, weights=[BINS / ((high - low) * len(values))] * len(shown))
    at = [low + (high - low) * i / 200 for i in range(201)]
    panel.plot(at, [curve(x) for x in at], color=GREY, label=name)
    panel.legend(fontsize="small")


def normal_curve(panel):
    """The distribution of errors whose σ are honest."""
    at = [MOST_SIGMAS * (i / 100 - 1) for i in range(201)]
    panel.plot(at, [NormalDist().pdf(x) for x in at], color=GREY)


def words(values, wanted=""):
    """How values in σ are spread."""
    if not values:
        return "none"
    within = "/".join(f"{share:.1f}" for share in analysis.shares_within(values))
    beyond = sum(abs(v) > MOST_SIGMAS for v in values)
    text = f"{within} % within 1/2/3 σ" + (f" ({wanted})" if wanted else "")
    return text + (f", {beyond} of {len(values)} beyond {MOST_SIGMAS:.0f} σ" if beyond else "")
