"""The command line, tables and plots. What needs pandas, pyarrow or matplotlib is skipped where they are missing."""

import contextlib
import importlib.util
import io
import json
import os
import subprocess
import sys
import unittest
from pathlib import Path
from unittest import mock

import starslog
from starslog.__main__ import main
from starslog.plots import PLOTS
from starslog.tests.samples import WithDirectory, as_line, made, solved
from starslog.tests.test_analysis import fits, stamp


def needs(*packages):
    """Skips a test where a package is missing."""
    missing = [package for package in packages if importlib.util.find_spec(package) is None]
    return unittest.skipIf(missing, f"{', '.join(missing)} not installed")


def run(*arguments):
    """What the program exits with, prints, and complains of."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main([str(argument) for argument in arguments])
        except SystemExit as end:
            code = end.code
    return code, out.getvalue(), err.getvalue()


class Program(WithDirectory):
    """What can be done without any package."""

    def test_a_summary_counts_and_names_damages(self):
        self.write(made(), end=as_line(solved())[:100])
        code, out, err = run("summary", self.directory)
        self.assertEqual(code, 0)
        self.assertIn("7 images in 1 log, 1 damaged lines", out)
        self.assertIn("solved 3 (42.9 %)", out)
        self.assertRegex(out, r"1 +14.3 %  no_match \(trailed\)")
        self.assertEqual(err.count("\n"), 1)
        self.assertIn(":8: torn", err)

    def test_a_summary_of_images_that_know_nothing(self):
        self.write([made()[-2]])
        code, out, err = run("summary", self.directory)
        self.assertEqual((code, err), (0, ""))
        self.assertIn("unreadable", out)

    def test_a_time_may_be_chosen(self):
        self.write([solved(captured_utc=stamp(i)) for i in range(10)] + [solved(captured_utc=None)])
        _, out, _ = run("summary", self.directory, "--since", "2026-12-20T00:00:02", "--until", "2026-12-20T00:00:05Z")
        self.assertIn("3 images", out)
        code, _, err = run("summary", self.directory, "--since", "2027-01-01")
        self.assertEqual((code, err.count("\n")), (2, 1))
        self.assertIn("no image of that time", err)

    def test_bad_input_is_one_line_and_exit_2(self):
        (self.directory / "empty").mkdir()
        (self.directory / "nothing.jsonl").touch()
        (self.directory / "image.fits").write_bytes(fits() + b"\n\xff" * 50)
        self.write([solved()])
        for arguments in (
            ("summary", self.directory / "nowhere"),
            ("summary", self.directory / "empty"),
            ("summary", self.directory / "nothing.jsonl"),
            ("summary", self.directory / "image.fits"),
        ):
            code, out, err = run(*arguments)
            self.assertEqual((code, out, err.count("\n")), (2, "", 1), arguments)
        self.assertEqual(run("plot", "sunset", self.directory, "-o", "x.png")[0], 2)

    def test_a_missing_package_is_named(self):
        self.write(made())
        hidden = dict.fromkeys(("matplotlib", "matplotlib.figure", "pandas", "pyarrow"))
        with mock.patch.dict(sys.modules, hidden):
            for arguments, package in (
                (("plot", "reasons", self.directory, "-o", self.directory / "x.png"), "matplotlib"),
                (("parquet", self.directory, "-o", self.directory / "x.parquet"), "pyarrow"),
            ):
                code, _, err = run(*arguments)
                self.assertEqual((code, err.count("\n")), (2, 1))
                self.assertIn(f"needs {package}: python3 -m pip install {package}", err)
            with self.assertRaisesRegex(starslog.MissingPackage, "pandas"):
                starslog.to_dataframe([])

    def test_it_runs_as_a_module_and_imports_the_standard_library_alone(self):
        path = self.write(made())
        scripts = Path(__file__).parents[2]
        code = "import sys, starslog.__main__; sys.exit(bool({'pandas', 'matplotlib', 'pyarrow', 'numpy'} & set(sys.modules)))"
        for arguments in (["-m", "starslog", "summary", str(path)], ["-c", code]):
            done = subprocess.run([sys.executable, *arguments], cwd=scripts, capture_output=True, timeout=60, env=os.environ)
            self.assertEqual(done.returncode, 0, done.stderr)


class Tables(WithDirectory):
    """Tables."""

    @needs("pandas")
    def test_a_row_for_each_image_by_utc(self):
        raw = solved(weather={"wind": 3.5, "gusts": [1]})
        solutions = starslog.get_solutions(self.write([*made(), raw]))
        frame = starslog.to_dataframe(solutions)
        self.assertEqual((len(frame), frame.index.name, str(frame.index.tz)), (8, "utc", "UTC"))
        row = frame.iloc[-1]
        self.assertEqual(str(frame.index[-1]), "2026-12-20 00:00:00+00:00")
        self.assertEqual(row["ra_deg"], raw["ra_deg"])
        self.assertEqual(row["stats_level_high"], raw["stats"]["level"][1])
        self.assertEqual(row["covariance_arcsec2_north_roll"], raw["covariance_arcsec2"][1][2])
        self.assertEqual((row["weather_wind"], row["weather_gusts"], row["boot"]), (3.5, "[1]", 0x26DAE556))
        self.assertTrue(frame["ra_deg"].isna().iloc[0] and frame.index.isna()[0])
        self.assertEqual(frame["candidate_matched"].dropna().tolist(), [21])
        # What stands in the log is in the table, all of it.
        nested = {"stats", "prior", "time_ms", "observer", "candidate", "sources", "covariance_arcsec2", "weather"}
        self.assertEqual({key for key in raw if key not in frame.columns}, nested)

    @needs("pandas")
    def test_columns_and_types_do_not_depend_on_the_rows(self):
        all_of = starslog.get_solutions(self.write(made()))
        wanted = starslog.to_dataframe(all_of).dtypes.to_dict()
        for some in (all_of[:1], all_of[2:3], []):
            self.assertEqual(starslog.to_dataframe(some).dtypes.to_dict(), wanted)
        wanted = starslog.sources_to_dataframe(all_of).dtypes.to_dict()
        self.assertEqual(starslog.sources_to_dataframe([]).dtypes.to_dict(), wanted)

    @needs("pandas")
    def test_a_row_for_each_source(self):
        solutions = starslog.get_solutions(self.write([solved(captured_utc=stamp(5)), solved(sources=[])]))
        frame = starslog.sources_to_dataframe(solutions)
        self.assertEqual(len(frame), len(solutions[0].sources))
        self.assertEqual(frame["star_name"].iloc[0], solutions[0].sources[0].star.name)
        self.assertEqual(set(map(str, frame.index)), {"2026-12-20 00:00:05+00:00"})

    @needs("pandas", "pyarrow")
    def test_parquet_reads_back_the_same(self):
        import pandas

        self.write(made())
        images, sources = self.directory / "i.parquet", self.directory / "s.parquet"
        self.assertEqual(run("parquet", self.directory, "-o", images, "--sources", sources), (0, "", ""))
        solutions = starslog.get_solutions(self.directory)
        pandas.testing.assert_frame_equal(pandas.read_parquet(images), starslog.to_dataframe(solutions))
        pandas.testing.assert_frame_equal(pandas.read_parquet(sources), starslog.sources_to_dataframe(solutions))


class Plots(WithDirectory):
    """Plots."""

    def draw(self, what, *more):
        path = self.directory / f"{what}.png"
        self.assertEqual(run("plot", what, self.directory, "-o", path, *more), (0, "", ""))
        self.assertTrue(path.read_bytes().startswith(b"\x89PNG"))

    @needs("matplotlib")
    def test_every_plot_is_drawn(self):
        self.write([solved(captured_utc=stamp(i), image_counter=i, image=f"image {i}") for i in range(15)] + made())
        day = self.directory / "images" / "2026-12-20"
        day.mkdir(parents=True)
        (day / "2026-12-20--00-00-03--000-26dae556-00000003.fits").write_bytes(fits())
        lens = self.directory / "lens.csv"
        lens.write_text("2026-12-20T00:00:00,-3.5\n")
        truth = self.directory / "truth.jsonl"
        truth.write_text(json.dumps({"image": "image 3"} | {key: solved()[key] for key in ("ra_deg", "dec_deg", "roll_deg")}))
        for what in PLOTS:
            self.draw(what)
        self.draw("coverage", "--truth", truth)
        self.draw("focus", "--temperatures", lens)

    @needs("matplotlib")
    def test_one_image_is_enough_and_too_little_is_said(self):
        self.write([solved(), solved(captured_utc=stamp(1))])
        for what in PLOTS:
            self.draw(what)
        self.write([made()[-2]])
        for what in set(PLOTS) - {"reasons"}:
            code, _, err = run("plot", what, self.directory, "-o", self.directory / "x.png")
            self.assertEqual((code, err.count("\n")), (2, 1), what)
            self.assertFalse((self.directory / "x.png").exists())

    @needs("matplotlib")
    def test_a_bad_output_is_one_line_and_exit_2(self):
        self.write([solved()])
        for name in ("x.hologram", "nowhere/x.png"):
            code, _, err = run("plot", "reasons", self.directory, "-o", self.directory / name)
            self.assertEqual((code, err.count("\n")), (2, 1), err)
