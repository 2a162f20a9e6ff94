"""Command line: python3 -m starslog COMMAND PATH. PATH is a log, or a directory of logs."""

import argparse
import sys
from pathlib import Path

from . import analysis, plots
from .fits import kept_images
from .logs import LogError, read_log
from .needs import MissingPackage
from .tables import to_parquet

# Damaged lines are named up to so many.
NAMED = 10
EXAMPLES = """examples:
  python3 -m starslog summary record
  python3 -m starslog plot coverage record -o coverage.pdf --since 2012-12-30T08:00 --until 2012-12-31
  python3 -m starslog plot focus record -o focus.png --temperatures lens.csv
  python3 -m starslog parquet record -o images.parquet --sources sources.parquet"""


def parser():
    """What the command line may say."""
    top = argparse.ArgumentParser(
        prog="starslog", description=__doc__, epilog=EXAMPLES, formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = top.add_subparsers(dest="command", required=True)
    common = argparse.ArgumentParser(add_help=False)
    common.add_argument("path", type=Path, metavar="PATH", help="a log, or a directory of logs")
    common.add_argument("--since", type=analysis.utc, metavar="UTC", help="only images from this time on")
    common.add_argument("--until", type=analysis.utc, metavar="UTC", help="only images before this time")
    commands.add_parser("summary", parents=[common], help="counts and medians, as text")
    # What is drawn stands before the path.
    what = argparse.ArgumentParser(add_help=False)
    what.add_argument("what", choices=plots.PLOTS)
    plot = commands.add_parser("plot", parents=[what, common], help="one plot, as PNG, PDF or SVG")
    plot.add_argument("-o", "--output", type=Path, required=True, metavar="FILE")
    plot.add_argument("--truth", type=Path, metavar="PATH", help="coverage: directory of NAME.truth.json, or JSON lines")
    plot.add_argument("--temperatures", type=Path, metavar="CSV", help="focus: lines of UTC,°C")
    parquet = commands.add_parser("parquet", parents=[common], help="tables for pandas and others")
    parquet.add_argument("-o", "--output", type=Path, required=True, metavar="FILE")
    parquet.add_argument("--sources", type=Path, metavar="FILE", help="a row for each source, into this file")
    return top


def main(arguments=None):
    """Runs a command; returns what the program exits with."""
    args = parser().parse_args(arguments)
    try:
        log = read_log(args.path)
        if log.damaged and not log.solutions:
            raise LogError(f"{log.damaged[0]}; nor can any other line be read")
        tell_damages(log.damaged)
        solutions = [solution for solution in log.solutions if is_within(solution, args.since, args.until)]
        if not solutions:
            raise LogError(f"{args.path}: there is no image" + (" of that time" if log.solutions else " in it"))
        run(args, solutions, len(log.damaged))
    except (LogError, MissingPackage, plots.NothingToPlot, OSError, ValueError) as error:
        print(f"starslog: {str(error).splitlines()[0] if str(error) else type(error).__name__}", file=sys.stderr)
        return 2
    return 0


def run(args, solutions, damaged):
    """Does what was asked for."""
    if args.command == "summary":
        print("\n".join(summary(solutions, damaged)))
    elif args.command == "parquet":
        to_parquet(solutions, args.output, args.sources)
    else:
        directory = args.path if args.path.is_dir() else args.path.parent
        beside = plots.Beside(
            truths=analysis.read_truth(args.truth) if args.truth else None,
            images=kept_images(directory) if args.what == "focus" else None,
            temperatures=analysis.read_temperatures(args.temperatures) if args.temperatures else None,
        )
        plots.draw(args.what, solutions, args.output, beside)


def is_within(solution, since, until):
    """Whether an image was taken in a time."""
    if since is None and until is None:
        return True
    time = solution.captured
    return time is not None and (since is None or time >= since) and (until is None or time < until)


def tell_damages(damaged):
    """Names the lines that could not be read."""
    for damage in damaged[:NAMED]:
        print(f"starslog: {damage}", file=sys.stderr)
    if len(damaged) > NAMED:
        print(f"starslog: and {len(damaged) - NAMED} damaged lines more", file=sys.stderr)


def summary(solutions, damaged):
    """Counts, rates and medians, a line each."""
    solved = [s for s in solutions if s.solved]
    times = [time for time, _ in analysis.timed(solutions)]
    logs = {s.log for s in solutions}
    yield f"{len(solutions)} images in {len(logs)} {'log' if len(logs) == 1 else 'logs'}, {damaged} damaged lines"
    if times:
        first, last = (f"{time:%Y-%m-%d %H:%M:%S}" for time in (min(times), max(times)))
        yield f"from {first} to {last} UTC; {len(solutions) - len(times)} without a time"
    yield f"solved {len(solved)} ({100 * len(solved) / len(solutions):.1f} %)"
    for name, count in analysis.endings(solutions):
        yield f"{count:8}  {100 * count / len(solutions):5.1f} %  {name}"
    yield "medians:"
    for label, values, form in medians(solutions, solved):
        value = analysis.median_of(values)
        yield f"{label:<34} {'not known' if value is None else form.format(value)}"


def medians(solutions, solved):
    """What the summary gives the median of: its name, its values, and how it is written."""
    yield "stars matched", [s.matched for s in solved], "{:.0f}"
    yield "sources found", [s.sources_found for s in solutions], "{:.0f}"
    yield "σ of the boresight per axis", [s.pointing_error_arcsec for s in solved], "{:.3f} arcsec"
    yield "σ of the roll", [s.sigma_roll_arcsec for s in solved], "{:.2f} arcsec"
    yield "plate scale", [s.platescale_arcsec_px for s in solved], "{:.4f} arcsec/px"
    yield "residuals, rms per axis", [s.rms_px for s in solved], "{:.3f} px"
    yield "χ² over the degrees of freedom", [s.chi2_per_dof for s in solved], "{:.3f}"
    yield "FWHM of stars", [s.stats and s.stats.fwhm_px for s in solutions], "{:.2f} px"
    yield "mean of the image", [s.stats and s.stats.mean for s in solutions], "{:.0f} ADU"
    yield "noise of the image", [s.stats and s.stats.noise for s in solutions], "{:.2f} ADU"
    yield "time since the image before", [step for _, step in analysis.intervals_s(solutions)], "{:.3f} s"
    took = [s.time_ms.total for s in solutions if s.time_ms] if analysis.has_solve_times(solutions) else []
    yield "time of solving", took, "{:.2f} ms"


if __name__ == "__main__":
    sys.exit(main())
