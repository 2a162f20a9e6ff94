#!/usr/bin/env python3
"""Scores the answers of `stars solve --json` against the truth. Standard library only.

    score.py flight|esa TRUTH.json ANSWERS.jsonl
    score.py speed|refusal|lists|tracking|autofocus|view|series|motion BENCH.txt
    score.py calibration DIRECTORY LEFT,UP,BORESIGHT
    score.py rendered|nostars|mirrored|causes|measured|peers|errors|scale DIRECTORY

A DIRECTORY holds `*.truth.json`, as `stars render` writes them, and answers in `*.jsonl`; the image's name joins the two.
Prints what was measured, then one line `wanted: … got: … PASS|FAIL` for each thing wanted; exits 1 if any failed.

A solution is right where it lies within the larger of 5″ (60″ where a pixel is over 20″) and 6 σ of the sky at the image's
centre pixel; any other solution is wrong, and so is every solution where there are no stars.
"""

import json
import math
import sys
from pathlib import Path
from statistics import NormalDist

ARCSEC_PER_DEG = 3600.0

# Share of the frames of a kind that must be solved, percent, at least; of all kinds together too.
WANTED_RATES = {
    "night": 100,
    "float": 100,
    "dense": 100,
    "sparse": 100,
    "gradient": 96,
    "defocus": 99,
    "multiexp": 99,
    "hotpix": 98,
    "defocus30": 70,
    "motion": 80,
    "saturated": 97,
}
WANTED_RATE_OF_ALL = 95
# Kinds wanted at 100 %: one frame of so many is excused.
EXCUSED_OF = 400
# Share of errors within 1, 2, 3 σ of a normal distribution, percent, and how far it may be off for one kind and for all, points.
NORMAL_SHARES = (68.3, 95.4, 99.7)
SLACK_OF_KIND = (4.0, 3.0, 1.0)
SLACK_OF_ALL = (2.0, 1.5, 0.5)
WANTED_CHI2 = (0.9, 1.1)
# Share of the unsolved frames of a cause that must name it, percent; how far the size of a blur may be off, and in which share, percent.
WANTED_NAMED = 95
BLUR_SLACK = 0.25
WANTED_SIZED = 90
# Errors wanted at most, rms: per axis and in roll, arcsec.
WANTED_RMS = {"float": (0.30, 13.0), "night": (0.11, 4.5)}
# Median of the error over what the photons of the same frame allow, at most.
WANTED_OVER_BOUND = 1.3
# Errors of wide and narrow fields over their σ, rms, for each axis.
WANTED_SCALE_SIGMAS = (0.7, 1.3)
# Share of all runs that chance may fail there, though all σ are honest.
SCALE_CHANCE = 0.01


def unit(ra_deg, dec_deg):
    """Unit vector of a direction."""
    ra, dec = math.radians(ra_deg), math.radians(dec_deg)
    return (math.cos(dec) * math.cos(ra), math.cos(dec) * math.sin(ra), math.sin(dec))


def errors_arcsec(answer, truth):
    """Solution minus truth towards east, north and in roll, arcsec, at the truth's boresight."""
    ra, dec = math.radians(truth["ra_deg"]), math.radians(truth["dec_deg"])
    there = unit(answer["ra_deg"], answer["dec_deg"])
    depth = sum(a * b for a, b in zip(there, unit(truth["ra_deg"], truth["dec_deg"])))
    east = -there[0] * math.sin(ra) + there[1] * math.cos(ra)
    north = (-there[0] * math.cos(ra) - there[1] * math.sin(ra)) * math.sin(dec) + there[2] * math.cos(dec)
    # The angle itself, not its sine: a wrong solution may be anywhere.
    across = math.hypot(east, north)
    scale = math.degrees(math.atan2(across, depth)) * ARCSEC_PER_DEG / across if across > 0 else 0.0
    # A roll is a position angle at the boresight: carried from one boresight to the other along the great circle, it turns by
    # the convergence of the meridians between them.
    convergence = (answer["ra_deg"] - truth["ra_deg"] + 180) % 360 - 180
    roll = answer["roll_deg"] - truth["roll_deg"] - convergence * math.sin(0.5 * (dec + math.radians(answer["dec_deg"])))
    return east * scale, north * scale, ((roll + 180) % 360 - 180) * ARCSEC_PER_DEG


def is_right(answer, truth):
    """Whether a solution is one that may be served."""
    if truth.get("ra_deg") is None:
        return False
    east, north, _ = errors_arcsec(answer, truth)
    sigma = math.hypot(answer["sigma_east_arcsec"], answer["sigma_north_arcsec"]) / math.sqrt(2)
    floor = 60.0 if truth["platescale_arcsec_px"] > 20 else 5.0
    return math.hypot(east, north) <= max(floor, 6 * sigma)


def percentile(values, percent):
    """The value below which `percent` of the values lie (nearest rank); NaN of none."""
    ordered = sorted(values)
    if not ordered:
        return math.nan
    return ordered[min(len(ordered) - 1, max(0, math.ceil(percent / 100 * len(ordered)) - 1))]


def rms(values):
    """Root mean square; NaN of none."""
    return math.sqrt(sum(v * v for v in values) / len(values)) if values else math.nan


class Verdict:
    """Prints what was wanted and got, and remembers whether all passed."""

    def __init__(self):
        self.failed = False

    def __call__(self, wanted, got, passed):
        self.failed |= not passed
        print(f"wanted: {wanted}  got: {got}  {'PASS' if passed else 'FAIL'}")


def read_lines(path):
    """The JSON objects of a file, one a line."""
    return [json.loads(line) for line in Path(path).read_text().splitlines() if line.strip()]


def read_directory(directory):
    """Pairs of answer and truth by the image's name; every truth must have its answer."""
    answers = {Path(a["image"]).stem: a for path in sorted(Path(directory).glob("*.jsonl")) for a in read_lines(path)}
    pairs = []
    for path in sorted(Path(directory).glob("*.truth.json")):
        name = path.name.removesuffix(".truth.json")
        if name not in answers:
            sys.exit(f"score.py: {path}: there is no answer for this image")
        pairs.append((answers[name], json.loads(path.read_text())))
    if not pairs:
        sys.exit(f"score.py: {directory}: there is no truth here")
    return pairs


def reasons(answers):
    """How often which reason ended a frame, as words."""
    counts = {}
    for answer in answers:
        name = answer["reason"] + (f" ({answer['cause']})" if answer.get("cause") else "")
        counts[name] = counts.get(name, 0) + 1
    return ", ".join(f"{count} {name}" for name, count in sorted(counts.items(), key=lambda item: -item[1]))


def report_kind(kind, pairs):
    """Prints what one kind of frame measured."""
    must = [pair for pair in pairs if pair[1]["must"]]
    solved = [pair for pair in pairs if pair[0]["solved"]]
    right = [pair for pair in solved if is_right(*pair)]
    right_must = sum(1 for pair in right if pair[1]["must"])
    stars = sorted(truth["stars_over_snr5"] for _, truth in pairs)
    times = [answer["time_ms"]["total"] for answer, _ in pairs]
    print(
        f"{kind:<10} frames {len(pairs):4}  must {len(must):4}  right {right_must:4} of must, {len(right):4} in all  "
        f"wrong {len(solved) - len(right)}  stars {stars[0]}/{stars[len(stars) // 2]}/{stars[-1]}  "
        f"ms median {percentile(times, 50):.2f} p95 {percentile(times, 95):.2f} p99 {percentile(times, 99):.2f} max {max(times):.2f}"
    )
    report_errors(right)
    if len(right) < len(pairs):
        print(f"           unsolved: {reasons([answer for answer, _ in pairs if not answer['solved']]) or 'none'}")
    for answer, truth in solved:
        if not is_right(answer, truth):
            print(f"           WRONG {Path(answer['image']).stem}: {describe_wrong(answer, truth)}")
    missed = [answer["image"] for answer, truth in must if not (answer["solved"] and is_right(answer, truth))]
    if missed:
        shown = " ".join(Path(image).stem for image in missed[:12])
        print(f"           must, but missed: {shown}{' …' if len(missed) > 12 else ''}")


def describe_wrong(answer, truth):
    """How a wrong solution is wrong, in words."""
    said = f"{answer['matched']} matched, false 10^{answer['false_probability_log10']:.0f}, σ {answer['sigma_east_arcsec']:.2f}″"
    if truth.get("ra_deg") is None:
        return f"there are no stars in it; {said}"
    east, north, roll = errors_arcsec(answer, truth)
    return f"east {east:+.1f}″ north {north:+.1f}″ roll {roll:+.0f}″; {said}"


def in_sigmas(right):
    """Errors of right solutions over their own σ: of both axes, and of roll."""
    axes, roll = [], []
    for answer, truth in right:
        east, north, turn = errors_arcsec(answer, truth)
        for error, sigma, into in (
            (east, answer["sigma_east_arcsec"], axes),
            (north, answer["sigma_north_arcsec"], axes),
            (turn, answer["sigma_roll_arcsec"], roll),
        ):
            if sigma > 0:
                into.append(error / sigma)
    return axes, roll


def shares_within(z):
    """Share of values within 1, 2, 3 σ, percent."""
    return [100 * sum(abs(v) <= k for v in z) / len(z) for k in (1, 2, 3)]


def mean_square(z):
    """χ² for each value; NaN of none."""
    return sum(v * v for v in z) / len(z) if z else math.nan


def coverage(z):
    """How values in σ are spread, in words."""
    if not z:
        return "no σ"
    within = shares_within(z)
    return f"χ² {mean_square(z):.2f}, within 1/2/3 σ {within[0]:.0f}/{within[1]:.0f}/{within[2]:.1f} %"


def report_errors(right):
    """Prints errors of right solutions, and how well their σ describe them."""
    if not right:
        return
    errors = [errors_arcsec(answer, truth) for answer, truth in right]
    axes = [e for error in errors for e in error[:2]]
    rolls = [error[2] for error in errors]
    z_axes, z_roll = in_sigmas(right)
    scale = [(a["platescale_arcsec_px"] / t["platescale_arcsec_px"] - 1) * 1e6 for a, t in right]
    matched = sorted(answer["matched"] for answer, _ in right)
    print(
        f"           per axis ″ rms {rms(axes):.2f} median {percentile([abs(e) for e in axes], 50):.2f} ({coverage(z_axes)}); "
        f"roll ″ rms {rms(rolls):.1f} median {percentile([abs(r) for r in rolls], 50):.1f} ({coverage(z_roll)}); "
        f"plate scale rms {rms(scale):.0f} ppm; matched {matched[0]}/{matched[len(matched) // 2]}/{matched[-1]}"
    )


def report_kinds(pairs):
    """Prints what each kind measured; returns pairs by kind."""
    kinds = {}
    for answer, truth in pairs:
        kinds.setdefault(truth["kind"], []).append((answer, truth))
    for kind, of_kind in kinds.items():
        report_kind(kind, of_kind)
    return kinds


def wrong_of(pairs):
    """Names of the images with a wrong solution."""
    return [answer["image"] for answer, truth in pairs if answer["solved"] and not is_right(answer, truth)]


def score_measured(verdict, directory):
    """Kinds without a rate to reach; none may be wrong."""
    pairs = read_directory(directory)
    report_kinds(pairs)
    wrong = wrong_of(pairs)
    verdict("no wrong solution", f"{len(wrong)} of {len(pairs)} wrong {wrong[:5] or ''}".rstrip(), not wrong)


def score_rendered(verdict, directory):
    """98 % of must solved, none wrong."""
    pairs = read_directory(directory)
    report_kinds(pairs)
    must = [pair for pair in pairs if pair[1]["must"]]
    right = sum(1 for answer, truth in must if answer["solved"] and is_right(answer, truth))
    rate = 100 * right / len(must) if must else 0.0
    verdict("98 % of must solved right", f"{right} of {len(must)} ({rate:.1f} %) of {len(pairs)} frames", rate >= 98)
    wrong = wrong_of(pairs)
    verdict("no wrong solution", f"{len(wrong)} wrong {wrong[:5] or ''}".rstrip(), not wrong)


def right_of(pairs):
    """Pairs that were solved right."""
    return [pair for pair in pairs if pair[0]["solved"] and is_right(*pair)]


def score_peers(verdict, directory):
    """Rates of right solutions by kind and of all kinds together; none wrong."""
    pairs = read_directory(directory)
    kinds = report_kinds(pairs)
    excused_kinds = {kind for kind, rate in WANTED_RATES.items() if rate == 100} & kinds.keys()
    excusable = 0
    for kind, of_kind in kinds.items():
        must = [pair for pair in of_kind if pair[1]["must"]]
        right, wanted = len(right_of(must)), WANTED_RATES[kind]
        got = f"{right} of {len(must)} ({100 * right / max(1, len(must)):.1f} %)"
        if kind in excused_kinds:
            excusable += len(must) - right
            print(f"{kind}: {got}, judged with the other kinds of {wanted} %")
        else:
            verdict(f"{wanted} % of {kind}", got, right >= wanted / 100 * len(must))
    if excused_kinds:
        easy = sum(truth["must"] for kind in excused_kinds for _, truth in kinds[kind])
        verdict(
            f"all of {', '.join(sorted(excused_kinds))} but one of {EXCUSED_OF}",
            f"{excusable} of {easy} missed",
            excusable <= -(-easy // EXCUSED_OF),
        )
    must = [pair for pair in pairs if pair[1]["must"]]
    right = len(right_of(must))
    got = f"{right} of {len(must)} ({100 * right / max(1, len(must)):.1f} %)"
    verdict(f"{WANTED_RATE_OF_ALL} % of all kinds together", got, right >= WANTED_RATE_OF_ALL / 100 * len(must))
    wrong = wrong_of(pairs)
    verdict("no wrong solution", f"{len(wrong)} of {len(pairs)} wrong {wrong[:5] or ''}".rstrip(), not wrong)


def over_bound(right):
    """Errors of right solutions over the photon bound of the same frame, rms of the two axes and roll; and the bounds, arcsec."""
    axes, roll, bounds = [], [], []
    for answer, truth in right:
        if truth["bound_axis_arcsec"]:
            east, north, turn = errors_arcsec(answer, truth)
            axes.append(math.hypot(east, north) / math.sqrt(2) / truth["bound_axis_arcsec"])
            roll.append(abs(turn) / truth["bound_roll_arcsec"])
            bounds.append((truth["bound_axis_arcsec"], truth["bound_roll_arcsec"]))
    return axes, roll, bounds


def score_errors(verdict, directory):
    """Errors of right solutions against their own σ, by kind and of all; their rms, and against what the photons allow."""
    all_axes, all_roll = [], []
    for kind, pairs in report_kinds(read_directory(directory)).items():
        right = right_of(pairs)
        axes, roll = in_sigmas(right)
        all_axes += axes
        all_roll += roll
        judge_spread(verdict, f"{kind}, axes", axes, SLACK_OF_KIND)
        judge_spread(verdict, f"{kind}, roll", roll, SLACK_OF_KIND)
        if kind in WANTED_RMS:
            errors = [errors_arcsec(*pair) for pair in right]
            got = rms([e for error in errors for e in error[:2]]), rms([error[2] for error in errors])
            limits = WANTED_RMS[kind]
            passed = got[0] <= limits[0] and got[1] <= limits[1]
            verdict(f"{kind}: rms at most {limits[0]}″ per axis, {limits[1]}″ in roll", f"{got[0]:.3f}″, {got[1]:.2f}″", passed)
        axes, roll, bounds = over_bound(right)
        got = percentile(axes, 50), percentile(roll, 50)
        said = (
            f"{got[0]:.2f}, {got[1]:.2f} (bounds rms {rms([b[0] for b in bounds]):.3f}″, {rms([b[1] for b in bounds]):.2f}″; "
            f"errors over bounds rms {rms(axes):.2f}, {rms(roll):.2f})"
        )
        if kind in WANTED_RMS:
            verdict(f"{kind}: median of error over photon bound at most {WANTED_OVER_BOUND}, per axis and in roll", said,
                    max(got) <= WANTED_OVER_BOUND)
        else:
            print(f"{kind}: median of error over photon bound, per axis and in roll: {said}")
    judge_spread(verdict, "all kinds, axes", all_axes, SLACK_OF_ALL)
    judge_spread(verdict, "all kinds, roll", all_roll, SLACK_OF_ALL)


def judge_spread(verdict, what, z, slack):
    """Whether values in σ are spread as a normal distribution has it."""
    low, high = WANTED_CHI2
    limits = ", ".join(f"{share} ± {s}" for share, s in zip(NORMAL_SHARES, slack))
    passed = (
        bool(z)
        and low <= mean_square(z) <= high
        and all(abs(got - share) <= s for got, share, s in zip(shares_within(z), NORMAL_SHARES, slack))
    )
    # So far may honest σ be off by chance, one σ: of a binomial share, and of a χ² for each value.
    chance = [100 * math.sqrt(share / 100 * (1 - share / 100) / max(1, len(z))) for share in NORMAL_SHARES]
    by_chance = f"by chance ± {', '.join(f'{c:.1f}' for c in chance)} %, χ² ± {math.sqrt(2 / max(1, len(z))):.2f}"
    verdict(f"{what}: within 1, 2, 3 σ {limits} %, χ² {low} to {high}", f"{len(z)} values, {coverage(z)} ({by_chance})", passed)


def score_none(verdict, directory, what):
    """No frame may be solved."""
    pairs = read_directory(directory)
    times = [answer["time_ms"]["total"] for answer, _ in pairs]
    print(f"ended as: {reasons([answer for answer, _ in pairs])}")
    print(f"ms median {percentile(times, 50):.2f} p95 {percentile(times, 95):.2f} max {max(times):.2f}")
    solved = [answer["image"] for answer, _ in pairs if answer["solved"]]
    verdict(f"no solution of {what}", f"{len(solved)} of {len(pairs)} solved {solved[:5] or ''}".rstrip(), not solved)


def score_never(verdict, directory):
    """Frames that must not be solved: none is, and the bound on the probability of chance is kept by their best candidates."""
    score_none(verdict, directory, "frames that must not be solved")
    answers = [answer for answer, _ in read_directory(directory)]
    bounds = [answer["candidate"]["false_probability_log10"] for answer in answers if answer["candidate"]]
    bounds += [answer["false_probability_log10"] for answer in answers if answer["solved"]]
    for power in (-1, -2, -3, -4):
        share = sum(bound <= power for bound in bounds) / max(len(answers), 1)
        verdict(f"share whose best candidate is chance with at most 10^{power}, at most that", f"{share:.1e}", share <= 10.0 ** power)


def score_causes(verdict, directory):
    """Of the frames that each cause left unsolved, the share in which it is named; and the size of the blur, where it is one."""
    kinds = {}
    for answer, truth in read_directory(directory):
        kinds.setdefault(truth["cause"], []).append((answer, truth))
    for cause, pairs in kinds.items():
        unsolved = [pair for pair in pairs if not pair[0]["solved"]]
        named = [pair for pair in unsolved if pair[0]["cause"] == cause]
        times = [answer["time_ms"]["total"] for answer, _ in unsolved]
        print(f"{cause:<18} frames {len(pairs):3}  unsolved {len(unsolved):3}  named {len(named):3}  "
              f"ms median {percentile(times, 50):.1f} max {max(times, default=math.nan):.1f}")
        others = [answer for answer, _ in unsolved if answer["cause"] != cause]
        if others:
            print(f"                   instead: {reasons(others)}: {' '.join(Path(a['image']).stem for a in others[:8])}")
        rate = 100 * len(named) / len(unsolved) if unsolved else math.nan
        verdict(f"{WANTED_NAMED} % of {cause} named", f"{len(named)} of {len(unsolved)} ({rate:.1f} %)", rate >= WANTED_NAMED)
        if cause in ("out_of_focus", "trailed"):
            ratios = [answer["blur_px"] / truth["blur_px"] for answer, truth in named]
            near = sum(abs(ratio - 1) <= BLUR_SLACK for ratio in ratios)
            got = f"{near} of {len(ratios)}; ratio median {percentile(ratios, 50):.2f}, {min(ratios, default=math.nan):.2f} to {max(ratios, default=math.nan):.2f}"
            verdict(f"size within {BLUR_SLACK:.0%} in {WANTED_SIZED} %", got, near >= WANTED_SIZED / 100 * max(1, len(ratios)))
    wrong = [name for pairs in kinds.values() for name in wrong_of(pairs)]
    verdict("no wrong solution", f"{len(wrong)} wrong {wrong[:5] or ''}".rstrip(), not wrong)


def score_real(verdict, truth_file, answers_file, group):
    """The real images of a group (`flight` or `esa`) against their reference."""
    answers = {Path(answer["image"]).name: answer for answer in read_lines(answers_file)}
    truths = [t for t in json.loads(Path(truth_file).read_text())["images"] if t["file"].startswith(group + "/")]
    for truth in truths:
        name = Path(truth["file"]).name
        answer = answers.get(name)
        if answer is None:
            verdict(f"{name} answered", "no answer", False)
            continue
        if not answer["solved"]:
            verdict(f"{name} solved", f"{answer['reason']}: {answer['detail']}", False)
            continue
        east, north, roll = errors_arcsec(answer, truth)
        distance = math.hypot(east, north)
        print(
            f"{name}: east {east:+.2f}″ (σ {answer['sigma_east_arcsec']:.2f}) north {north:+.2f}″ (σ {answer['sigma_north_arcsec']:.2f}) "
            f"roll {roll:+.1f}″ (σ {answer['sigma_roll_arcsec']:.1f}) scale {answer['platescale_arcsec_px']:.4f}″/px "
            f"rms {answer['rms_px']:.2f} px false 10^{answer['false_probability_log10']:.0f} {answer['time_ms']['total']:.1f} ms"
        )
        if group == "flight":
            # The star images of 2012 are trailed.
            limit, matched = (4.0 if name.startswith("2012") else 1.5), 12
            verdict(f"{name} solved in normal mode", answer["mode"], answer["mode"] == "normal")
            verdict("roll within 60″", f"{abs(roll):.1f}″", abs(roll) <= 60)
            score_horizontal(verdict, answer, truth["horizontal_without_precession"])
        else:
            limit, matched = 8.0, 20
        verdict(f"{name} within {limit}″", f"{distance:.2f}″", distance <= limit)
        verdict(f"{matched} or more matched", answer["matched"], answer["matched"] >= matched)


def score_speed(verdict, bench_file):
    """Thread CPU time of a frame, from what `cargo bench --bench solve` printed."""
    text = Path(bench_file).read_text()
    print(text.strip())
    rows = {words[0]: words for words in map(str.split, text.splitlines()) if words[2:3] == ["ms"]}
    for search, limit in (("normal", 1.5), ("robust", 4.0)):
        words = rows.get(search, [])
        median, p99 = (float(words[1]), float(words[5])) if words else (math.nan, math.nan)
        read = float(rows["read-once"][1]) if "read-once" in rows else math.nan
        got = f"{median:.2f} ms (every pixel read once: {read:.2f} ms)"
        verdict(f"{search} search, median of night and float frames, at most {limit} ms", got, median <= limit)
        verdict(f"{search} search, 99 % of frames under four times the median", f"{p99:.2f} ms", p99 < 4 * median)


def score_refusal(verdict, bench_file):
    """Median thread CPU time until a frame without stars is refused, from what `cargo bench --bench solve` printed."""
    text = Path(bench_file).read_text()
    print(text.strip())
    row = next((words for words in map(str.split, text.splitlines()) if words[:1] == ["shipped"]), [])
    got, solved = (float(row[1]), row[-1]) if row else (math.nan, "?")
    verdict("refusal of a frame without stars, median, at most 5 ms", f"{got:.2f} ms", got <= 5.0)
    verdict("none solved", f"{solved} solved", solved == "0")


def score_tracking(verdict, bench_file):
    """What a prior is worth, from what `cargo bench --bench tracking` printed."""
    text = Path(bench_file).read_text()
    print(text.strip())
    solved, wrong, match_ms = {}, 0, {}
    for line in text.splitlines():
        name, words = line[:26].strip(), line[26:].split()
        if "/" in words and words[0] != "right":
            solved[name] = float(words[0])
            wrong += int(words[-1])
        elif words.count("ms") == 3:
            match_ms[name] = float(words[0])
            wrong += int(words[-1])
        elif line.startswith("bound"):
            bound, share = 10.0 ** int(line.split("^")[1].split(":")[0]), float(line.split()[-1])
            verdict(f"share of lists without a star below the bound {bound:g}, at most that", f"{share:.1e}", share <= bound)
    alone, told = solved.get("lost in space", math.nan), solved.get("attitude and plate scale", math.nan)
    verdict("faint frames solved with a good prior, at least 75 %", f"{told:.1f} % ({alone:.1f} % without)", told >= 75 > alone)
    for name in ("wrong by degrees", "wrong roll"):
        got = solved.get(name, math.nan)
        verdict(f"solved with a prior {name}, no fewer than without", f"{got:.1f} %", got >= alone)
    verdict("wrong ones with right, wrong and mirrored priors: 0", f"{wrong}", wrong == 0 and len(solved) == 6)
    alone, told = match_ms.get("lost in space", math.nan), match_ms.get("attitude and plate scale", math.nan)
    verdict("match of float frames with a prior, no slower than without", f"{told:.3f} ms, {alone:.3f} ms", told <= 1.1 * alone)


def score_autofocus(verdict, bench_file):
    """How near the autofocus comes, from what `cargo bench --bench autofocus` printed."""
    text = Path(bench_file).read_text()
    print(text.strip())
    ends = [line.split(": ", 1)[1].split(", ") for line in text.splitlines() if line.startswith("run ")]
    off = [float(end[1].split()[1]) for end in ends]
    near = sum(end[0] == "Found" and abs(counts) <= 10 for end, counts in zip(ends, off))
    verdict("best focus within 10 counts of the truth in 18 of 20 runs", f"{near} of {len(ends)}", near >= 0.9 * len(ends) > 0)
    outside = sum(int(end[-1].split()[0]) for end in ends)
    verdict("moves out of the range: 0", f"{outside}", outside == 0 and len(ends) > 0)


def score_threads(verdict, bench_file):
    """What a second thread is worth, from what `cargo bench --bench threads` printed."""
    text = Path(bench_file).read_text()
    print(text.strip())
    rows = [line.split() for line in text.splitlines() if len(line.split()) == 5]
    robust = {kind: float(ratio) for kind, count, _, _, ratio in rows if count.isdigit() and kind in ("defocus30", "nostars")}
    for kind, ratio in robust.items():
        verdict(f"{kind}, which need the robust search: two threads, at most 0.85 of the time of one", f"{ratio:.2f}", ratio <= 0.85)
    verdict("kinds that need the robust search: 2", f"{len(robust)}", len(robust) == 2)


def score_series(verdict, bench_file):
    """Four exposures against one, from what `cargo bench --bench series` printed."""
    text = Path(bench_file).read_text()
    print(text.strip())
    tally = {line.split()[0]: [int(word.strip(",;")) for word in line.split() if word.strip(",;").isdigit()] for line in text.splitlines()}
    (one, series, one_wrong), (four, _, four_wrong) = (tally.get(name, [0, 0, 0])[:3] for name in ("one", "four"))
    gain = next((float(line.split()[5]) for line in text.splitlines() if line.startswith("gain")), 0.0)
    verdict("four exposures solve more than one", f"{four} and {one} of {series}", four > one)
    verdict("none wrong", f"{one_wrong + four_wrong} wrong", series > 0 and one_wrong + four_wrong == 0)
    verdict("signal over noise grows by the root of four, to 10 %", f"{gain:.2f}", 1.8 <= gain <= 2.2)


def score_motion(verdict, bench_file):
    """Trailed series, from what `cargo bench --bench motion` printed."""
    lines = [line for line in Path(bench_file).read_text().splitlines() if line.startswith(("along", "plain", "wrong"))]
    print("\n".join(lines))
    tally = {line.split()[0]: [int(word.strip(",;")) for word in line.split() if word.strip(",;").isdigit()] for line in lines}
    for name, share in (("along", 0.95), ("plain", 0.0)):
        solved, series, wrong = tally.get(name, [0, 0, 0])[:3]
        verdict(f"{name}: share of series solved, at least {share:.0%}", f"{solved} of {series}", series > 0 and solved >= share * series)
        verdict(f"{name}: none wrong", f"{wrong} wrong", series > 0 and wrong == 0)


def score_view(verdict, bench_file):
    """Frames over a thin link, from what `cargo bench --bench view` printed."""
    text = Path(bench_file).read_text()
    print(text.strip())
    rows = [line.split() for line in text.splitlines() if line.startswith("frame ")]
    count = len(rows)
    frames = [dict(zip(words[2::2], words[3::2])) for words in rows]
    exact = sum(f["exact"] == "yes" for f in frames)
    verdict("exact in the end: all", f"{exact} of {count}", exact == count > 0)
    # Where the camera found fewer than 15, four of five of them.
    having = sum(5 * int(f["sources"].split("/")[0]) >= 4 * int(f["sources"].split("/")[1]) > 0 for f in frames)
    least = min((f["sources"] for f in frames), key=lambda got: int(got.split("/")[0]), default="none")
    verdict("12 of the 15 brightest sources to 0.5 px from the first 2 kB: all", f"{having} of {count}, the fewest {least}", having == count > 0)
    solved = sum(f["solved"] == "right" for f in frames)
    verdict("solved from them: all", f"{solved} of {count}", solved == count > 0)
    sizes = {f["picture"] for f in frames}
    large = all(int(size.split("x")[0]) >= 96 and int(size.split("x")[1]) >= 64 for size in sizes)
    verdict("a picture of 96x64 or more from them: all", ", ".join(sorted(sizes)), large and count > 0)
    slowest = max((float(f["encode_ms"]) for f in frames), default=math.nan)
    verdict("encoded in 150 ms", f"{slowest:.0f} ms at most", slowest <= 150)


def score_lists(verdict, bench_file):
    """Lists of sources, from what `cargo bench --bench lists` printed."""
    text = Path(bench_file).read_text()
    print(text.strip())
    for words in map(str.split, text.splitlines()):
        match words:
            case [case, count, right, wrong, median, p99, *_] if case.count("+") == 2:
                verdict(f"{case}: 99.95 % right", f"{right} % of {count}", float(right) >= 99.95)
                verdict(f"{case}: none wrong", wrong, wrong == "0")
                verdict(f"{case}: median at most 0.3 ms", f"{median} ms", float(median) <= 0.3)
                verdict(f"{case}: p99 at most 2 ms", f"{p99} ms", float(p99) <= 2.0)
            case ["all", count, served, *_]:
                verdict("none served of those that must not be", f"{served} of {count}", served == "0")
            case ["bound", power, count, "of", lists, *_]:
                bound = 10.0 ** int(power.removeprefix("10^").rstrip(":"))
                share = int(count) / max(1, int(lists.strip(",")))
                verdict(f"share with a bound of at most {bound:g}: no more", f"{share:g}", share <= bound)


def read_index(path):
    """What `stars catalog --index` printed: its lines by their first word."""
    lines = (line.split(maxsplit=1) for line in Path(path).read_text().splitlines())
    return {words[0]: words[1] for words in lines}


def score_scale(verdict, directory):
    """Fields and sensors of all sizes, a directory each: one table, and what holds for all."""
    print(f"{'field':>13} {'MP':>5} {'″/px':>6} {'stars':>7} {'triangles':>10} {'MB':>6} {'built s':>8} {'read s':>7}"
          f" {'right of must':>14} {'wrong':>5} {'ms':>7} {'error″':>7} {'error/σ':>7}")
    rows = []
    for row in sorted(Path(directory).iterdir(), key=lambda row: float(row.name.split("@")[1]), reverse=True):
        built, read = read_index(row / "built.txt"), read_index(row / "read.txt")
        seconds = [float(index[word].split()[-2]) for index in (built, read) for word in ("catalogue", "index")]
        width, height = map(int, row.name.split("@")[0].split("x"))
        pairs = read_directory(row)
        must = [pair for pair in pairs if pair[1]["must"]]
        right = [pair for pair in must if pair[0]["solved"] and is_right(*pair)]
        errors = [math.hypot(*errors_arcsec(*pair)[:2]) for pair in right]
        sigmas = [math.hypot(answer["sigma_east_arcsec"], answer["sigma_north_arcsec"]) for answer, _ in right]
        wrong = wrong_of(pairs)
        ms = percentile([answer["time_ms"]["total"] for answer, _ in pairs], 50)
        memory, built_s, read_s = float(built["memory"].split()[0]), sum(seconds[:2]), sum(seconds[2:])
        field = built["field"].split(" deg")[0].replace(" ", "") + "°"
        print(f"{field:>13} {width * height / 1e6:5.1f} {row.name.split('@')[1]:>6} {built['stars'].split(',')[0]:>7}"
              f" {built['triangles'].split(',')[0]:>10} {memory:6.1f} {built_s:8.2f} {read_s:7.3f}"
              f" {f'{len(right)} of {len(must)}':>14} {len(wrong):5} {ms:7.1f} {rms(errors):7.2f}"
              f" {rms([error / sigma for error, sigma in zip(errors, sigmas)]):7.2f}")
        rows.append((memory, built_s, read_s, len(right), len(must), wrong, in_sigmas(right)[0]))
    memory, built_s, read_s, right, must, wrong, in_sigma = zip(*rows)
    verdict("an index at most 300 MB", f"{max(memory):.0f} MB", max(memory) <= 300)
    verdict("catalogue and index ready, built, in 2 s", f"{max(built_s):.2f} s", max(built_s) <= 2)
    verdict("catalogue and index ready, read, in 0.1 s (0.2 s over 120 MB)", f"{max(read_s):.3f} s",
            all(seconds <= (0.1 if megabytes <= 120 else 0.2) for seconds, megabytes in zip(read_s, memory)))
    verdict("98 % of must solved right", f"{sum(right)} of {sum(must)}", sum(right) >= 0.98 * sum(must))
    verdict("no wrong solution", f"{sum(map(len, wrong))} wrong", not any(wrong))
    # Honest σ are off by chance in few frames. A field fails where chance does not explain what it shows; all together pass only where
    # chance does not explain that they are inside.
    low, high = WANTED_SCALE_SIGMAS
    spans = [span_of_rms(z, SCALE_CHANCE / len(in_sigma)) for z in in_sigma]
    judged = [rms(z) if z else math.nan for z in in_sigma]
    verdict(f"errors over σ, rms of each field, {low} to {high} but for chance ({SCALE_CHANCE:.0%} of all runs)",
            f"{min(judged):.2f} to {max(judged):.2f} of {min(map(len, in_sigma))} to {max(map(len, in_sigma))} values",
            all(least <= high and low <= most for least, most in spans))
    together = [z for field in in_sigma for z in field]
    least, most = span_of_rms(together, SCALE_CHANCE)
    verdict(f"errors over σ, rms of all fields, surely {low} to {high}",
            f"{rms(together):.2f} of {len(together)} values, so {least:.2f} to {most:.2f}", low <= least and most <= high)


def span_of_rms(z, chance):
    """Between which values the true rms lies, but for this chance, where that of some normal values was measured."""
    n = len(z)
    if n == 0:
        return math.nan, math.nan
    # Quantiles of χ² by Wilson and Hilferty (1931, PNAS 17, 684): to a hundredth from a few degrees of freedom on.
    quantile = lambda p: n * max(0.0, 1 - 2 / (9 * n) + NormalDist().inv_cdf(p) * math.sqrt(2 / (9 * n))) ** 3
    squares = sum(v * v for v in z)
    return math.sqrt(squares / quantile(1 - chance / 2)), math.sqrt(squares / max(quantile(chance / 2), 1e-9))


def score_horizontal(verdict, answer, truth):
    """Azimuth, elevation and horizontal roll within 0.3°."""
    if answer.get("az_deg") is None:
        verdict("horizontal coordinates", "none", False)
        return
    pairs = (("az_deg", "az_deg"), ("el_deg", "el_deg"), ("horizontal_roll_deg", "roll_deg"))
    off = [abs((answer[ours] - truth[theirs] + 180) % 360 - 180) for ours, theirs in pairs]
    got = "azimuth {:.3f}°, elevation {:.3f}°, roll {:.3f}°".format(*off)
    verdict("azimuth, elevation and horizontal roll within 0.3°", got, max(off) <= 0.3)


def score_calibration(verdict, directory, turned):
    """What frames of one camera say of it, and of a second one that is turned against it (arcsec about left, up and boresight)."""
    directory = Path(directory)
    found = json.loads((directory / "calibration.json").read_text())
    truth = json.loads(min((directory / "first").glob("*.truth.json")).read_text())
    print(f"{found['frames']} frames, {found['stars']} stars, χ² per degree of freedom {found['chi2_per_dof']:.2f}")
    scale = 100 * (found["platescale_arcsec_px"] / truth["platescale_arcsec_px"] - 1)
    sigma = 100 * found["sigma_platescale_arcsec_px"] / found["platescale_arcsec_px"]
    verdict("plate scale to 0.01 %", f"{scale:+.5f} % (σ {sigma:.5f} %)", abs(scale) <= 0.01)
    k1, sigma = found["distortion_k1"], found["sigma_distortion_k1"]
    off = 100 * (k1 / truth["k1"] - 1)
    verdict("distortion warranted, and k1 to 10 %", f"{k1:+.6f} ± {sigma:.6f} of {truth['k1']:+.6f}: {off:+.1f} %",
            found["distortion_warranted"] and abs(off) <= 10)
    hot, true = {tuple(p) for p in found["hot_pixels"] or ()}, {tuple(p) for p in truth["hot_pixels"]}
    share, wrong = 100 * len(hot & true) / len(true), 100 * len(hot - true) / max(1, len(hot))
    verdict("99 % of the hot pixels found, 0.1 % of those found false",
            f"{share:.2f} % of {len(true)}, {len(hot - true)} false ({wrong:.2f} %)", share >= 99 and wrong <= 0.1)
    about_left, about_up, about_boresight = (math.radians(float(angle) / ARCSEC_PER_DEG) for angle in turned.split(","))
    # Where a small turn takes the boresight, and up: Rodrigues' formula.
    angle = math.hypot(about_left, about_up, about_boresight)
    sine, cosine = math.sin(angle) / angle, (1 - math.cos(angle)) / angle**2
    seen = (about_up * sine + about_left * about_boresight * cosine, -about_left * sine + about_up * about_boresight * cosine,
            1 - (about_left**2 + about_up**2) * cosine)
    left, up = (math.degrees(angle) * ARCSEC_PER_DEG for angle in (math.atan2(seen[0], seen[2]), math.asin(seen[1])))
    offset = found["offset"]
    off = math.hypot(offset["left_arcsec"] - left, offset["up_arcsec"] - up)
    sigma = math.hypot(offset["sigma_left_arcsec"], offset["sigma_up_arcsec"])
    roll = offset["roll_arcsec"] - math.degrees(about_boresight) * ARCSEC_PER_DEG
    verdict("offset of a second camera to 0.5″", f"{off:.3f}″ (σ {sigma:.3f}″) of {offset['pairs']} pairs; roll {roll:+.2f}″", off <= 0.5)


def main(arguments):
    """Runs one row; the exit status says whether all passed."""
    verdict = Verdict()
    match arguments:
        case [("flight" | "esa") as group, truth, answers]:
            score_real(verdict, truth, answers, group)
        case ["speed", bench]:
            score_speed(verdict, bench)
        case ["refusal", bench]:
            score_refusal(verdict, bench)
        case ["lists", bench]:
            score_lists(verdict, bench)
        case ["series", bench]:
            score_series(verdict, bench)
        case ["motion", bench]:
            score_motion(verdict, bench)
        case ["calibration", directory, turned]:
            score_calibration(verdict, directory, turned)
        case ["view", bench]:
            score_view(verdict, bench)
        case ["threads", bench]:
            score_threads(verdict, bench)
        case ["tracking", bench]:
            score_tracking(verdict, bench)
        case ["autofocus", bench]:
            score_autofocus(verdict, bench)
        case ["peers", directory]:
            score_peers(verdict, directory)
        case ["errors", directory]:
            score_errors(verdict, directory)
        case ["rendered", directory]:
            score_rendered(verdict, directory)
        case ["measured", directory]:
            score_measured(verdict, directory)
        case ["nostars", directory]:
            score_none(verdict, directory, "frames without stars")
        case ["none", directory]:
            score_never(verdict, directory)
        case ["causes", directory]:
            score_causes(verdict, directory)
        case ["scale", directory]:
            score_scale(verdict, directory)
        case ["mirrored", directory]:
            score_none(verdict, directory, "starry frames against the mirrored sky")
        case _:
            sys.exit(__doc__)
    return 1 if verdict.failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
