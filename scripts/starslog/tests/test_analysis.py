"""Numbers: headers of images, errors, coverage of σ."""

import math
import random
from datetime import UTC, datetime, timedelta

import starslog
from starslog import analysis
from starslog.fits import NotFits, header_of
from starslog.outcome import axes
from starslog.tests.samples import WithDirectory, solved

CARDS = """SIMPLE  =                    T / conforms to FITS 4.0
BITPIX  =                   16 / bits per pixel
FRAMEID = 'it''s / here'       / where the image came from
HIERARCH COUNTER_STARS =    38
LAT     =               -77.85 / [deg] latitude of the observer
CD1_2   = 5.527724926805126E-5 / [deg/pixel]
EXPTIME =               1.2D-1 / [s] one exposure
FOCUS   =                 2995 / [count] focus position
FOCUS   =                    1 / the first one counts
APERTURE=                   -1 / UNKNOWN
COMMENT   = no value
END"""
BOOT = 0x26DAE556


def fits(cards=CARDS, padding=0):
    """A FITS file without pixels."""
    lines = cards.split("\n")
    lines = lines[:1] + ["COMMENT"] * padding + lines[1:]
    text = "".join(line.ljust(80) for line in lines).encode()
    return text + b" " * (-len(text) % 2880)


def stamp(seconds):
    """A time of the log."""
    return (datetime(2026, 12, 20, tzinfo=UTC) + timedelta(seconds=seconds)).strftime("%Y-%m-%dT%H:%M:%S.%f")[:-3]


class Headers(WithDirectory):
    """Headers of images."""

    def put(self, name, content):
        path = self.directory / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
        return path

    def test_values_by_keyword(self):
        wanted = {
            "SIMPLE": True, "BITPIX": 16, "FRAMEID": "it's / here", "COUNTER_STARS": 38, "LAT": -77.85,
            "CD1_2": 5.527724926805126e-5, "EXPTIME": 0.12, "FOCUS": 2995,
        }
        self.assertEqual(starslog.read_header(self.put("a.fits", fits())), wanted)
        self.assertEqual(starslog.read_header(self.put("b.fits", fits(padding=100))), wanted)

    def test_other_files_are_refused(self):
        for content in (b"", b"SIMPLE", b"not FITS" * 1000, fits()[:400]):
            with self.assertRaises(NotFits):
                starslog.read_header(self.put("a.fits", content))

    def test_a_kept_image_is_found_by_start_and_counter(self):
        (solution,) = starslog.get_solutions(self.write([solved(image_counter=31)]))
        self.assertEqual(header_of(solution, starslog.kept_images(self.directory)), {})
        kept = self.put("images/2026-12-20/2026-12-20--00-00-00--000-26dae556-00000031.fits", fits())
        self.put("images/2026-12-20/2026-12-20--00-00-01--000-26dae557-00000031.fits", b"of another start")
        self.put("images/2026-12-20/2026-12-20--00-00-01--000-26dae556-00000032.part", b"")
        self.assertEqual(starslog.kept_images(self.directory)[BOOT, 31], kept)
        header = header_of(solution, starslog.kept_images(self.directory))
        self.assertEqual(analysis.focus_of(solution, header), 2995)
        self.assertIsNone(analysis.temperature_of(solution, header))
        self.assertEqual(analysis.temperature_of(solution, {"CCD-TEMP": 5.0, "LENSTEMP": -2.5}), -2.5)
        logged = solved(focus_counts=2800, temperature_camera_c=21.0, temperature_lens_c=None)
        (solution,) = starslog.get_solutions(self.write([logged]))
        self.assertEqual((analysis.focus_of(solution, header), analysis.temperature_of(solution, {})), (2800, 21.0))
        solution.temperature_lens_c = -7.25
        self.assertEqual(analysis.temperature_of(solution, {"LENSTEMP": -2.5}), -7.25)


class Errors(WithDirectory):
    """Attitudes against others."""

    def read(self, outcomes):
        return starslog.get_solutions(self.write(outcomes))

    def test_differences_are_east_north_and_position_angle(self):
        at = axes(100, 60, 20)
        for east, north, roll in ((3.0, 0.0, 0.0), (0.0, -2.0, 0.0), (0.0, 0.0, 50.0), (1.0, 1.0, -7.0)):
            step = east / 3600 / math.cos(math.radians(60))
            # Towards East the direction of North turns by the convergence of the meridians.
            convergence = step * math.sin(math.radians(60))
            got = analysis.differences(axes(100 + step, 60 + north / 3600, 20 + roll / 3600 + convergence), at)
            for value, wanted in zip(got, (east, north, roll)):
                self.assertAlmostEqual(value, wanted, delta=1e-3)

    def test_errors_over_sigma_of_a_truth(self):
        truth = {"ra_deg": 10.0, "dec_deg": 0.0, "roll_deg": 5.0}
        sigma = {"sigma_east_arcsec": 2.0, "sigma_north_arcsec": 1.0, "sigma_roll_arcsec": 10.0}
        raw = solved(image="frames/a.fits", **truth, **sigma) | {"ra_deg": 10 + 4 / 3600, "roll_deg": 5 - 30 / 3600}
        (self.directory / "a.truth.json").write_text('{"kind": "float", "ra_deg": 10, "dec_deg": 0, "roll_deg": 5}')
        (self.directory / "b.truth.json").write_text('{"ra_deg": null}')
        lines = self.directory / "truth.jsonl"
        lines.write_text('{"image": "a.fits", "ra_deg": 10, "dec_deg": 0, "roll_deg": 5}\n\n')
        solutions = self.read([raw, solved(image="unknown")])
        for path in (self.directory, lines):
            errors = analysis.errors_in_sigma(solutions, analysis.read_truth(path))
            for values, wanted in zip(errors, (2.0, 0.0, -3.0)):
                self.assertEqual(len(values), 1)
                self.assertAlmostEqual(values[0], wanted, places=4)

    def test_bad_truths_are_refused(self):
        path = self.directory / "truth.jsonl"
        for text in ("", "{", "[1]", '{"image": "a"}', '{"image": "a", "ra_deg": 1}', '{"image": "a", "ra_deg": "x"}'):
            path.write_text(text)
            with self.assertRaises(starslog.LogError):
                analysis.read_truth(path)

    def test_repeatability_of_an_even_turn_with_honest_errors(self):
        draw = random.Random(7)
        at, to = axes(30, -60, 10), axes(33, -58, 14)
        outcomes = []
        for i in range(400):
            _, up, boresight = analysis.turned(at, to, i / 400)
            ra, dec = math.degrees(math.atan2(boresight[1], boresight[0])), math.degrees(math.asin(boresight[2]))
            left_at_north, up_at_north, _ = axes(ra, dec, 0)
            roll = math.degrees(math.atan2(sum(map(float.__mul__, up, left_at_north)), sum(map(float.__mul__, up, up_at_north))))
            east, north, turn = (draw.gauss(0, sigma) / 3600 for sigma in (1.0, 2.0, 20.0))
            step = east / math.cos(math.radians(dec))
            outcomes.append(solved(
                captured_utc=stamp(i), ra_deg=ra + step, dec_deg=dec + north,
                roll_deg=roll + turn + step * math.sin(math.radians(dec)),
                sigma_east_arcsec=1.0, sigma_north_arcsec=2.0, sigma_roll_arcsec=20.0, sources=[], triangles=[],
            ))
        solutions = self.read(outcomes)
        for values in analysis.repeatability(solutions):
            self.assertEqual(len(values), 398)
            self.assertAlmostEqual(sum(v * v for v in values) / len(values), 1.0, delta=0.25)
        solutions[10].solved = False
        self.assertEqual([len(values) for values in analysis.repeatability(solutions)], [395] * 3)

    def test_residuals_over_sigma_and_plate_scales(self):
        star = {"id": 1, "residual_px": 0.4}
        sources = [{"id": 0, "sigma_px": 0.2, "star": star}, {"id": 1, "sigma_px": None, "star": star}, {"id": 2, "star": None}]
        scales = [9.5] * 11 + [9.6] + [9.5] * 11
        outcomes = [solved(sources=sources, platescale_arcsec_px=s, sigma_platescale_arcsec_px=0.05) for s in scales]
        solutions = self.read(outcomes)
        self.assertEqual(analysis.residuals_in_sigma(solutions), [2.0] * 23)
        steps = analysis.platescale_steps(solutions)
        self.assertAlmostEqual(steps[11], 2.0)
        self.assertEqual({round(step, 9) for step in steps[:11] + steps[12:]}, {0.0})

    def test_intervals_leave_out_steps_of_the_clock(self):
        times = [stamp(0), stamp(1), stamp(-5), None, stamp(3), stamp(86_404), stamp(86_404.5)]
        solutions = self.read([solved(captured_utc=time) for time in times])
        self.assertEqual([step for _, step in analysis.intervals_s(solutions)], [1.0, 0.5])

    def test_temperatures_of_a_table_are_taken_from_the_nearest_time(self):
        path = self.directory / "lens.csv"
        path.write_text("# UTC, °C\n2026-12-20T00:10:00Z,-3.5\n2026-12-20 00:00:00,-2\n")
        table = analysis.read_temperatures(path)
        at = [analysis.nearest(table, table[0][0] + timedelta(minutes=m)) for m in (-11, -1, 0, 4, 6, 19, 21)]
        self.assertEqual(at, [None, -2.0, -2.0, -2.0, -3.5, -3.5, None])
        path.write_text("now,cold\n")
        with self.assertRaisesRegex(starslog.LogError, "utc,celsius"):
            analysis.read_temperatures(path)
