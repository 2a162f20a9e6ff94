"""Reading of logs: nothing is lost, and nothing that cannot be read is passed over in silence."""

import json
import math
import statistics
import warnings
from datetime import UTC, datetime

import starslog
from starslog.tests.samples import MADE, WithDirectory, as_line, made, solved


class Objects(WithDirectory):
    """Outcomes as objects."""

    def test_objects_equal_the_outcomes_of_the_program(self):
        solutions = starslog.get_solutions(MADE)
        self.assertEqual([s.to_dict() for s in solutions], made())
        self.assertEqual([s.raw for s in solutions], made())
        self.assertEqual([json.dumps(s.to_dict()) for s in solutions], [json.dumps(o) for o in made()], "the order of the keys")

    def test_no_key_of_the_program_is_unknown_here(self):
        def unknown(record):
            yield from record.extra
            for name in record.__dataclass_fields__:
                value = getattr(record, name)
                for item in value if isinstance(value, list) else [value]:
                    if hasattr(item, "extra"):
                        yield from unknown(item)

        self.assertEqual([key for s in starslog.get_solutions(MADE) for key in unknown(s)], [])

    def test_all_is_an_attribute(self):
        raw = solved()
        (solution,) = starslog.get_solutions(self.write([raw]))
        self.assertEqual(solution.ra_deg, raw["ra_deg"])
        self.assertEqual(solution.covariance_arcsec2[0][1], raw["covariance_arcsec2"][0][1])
        self.assertEqual(solution.stats.level, raw["stats"]["level"])
        self.assertEqual(solution.time_ms.match, raw["time_ms"]["match"])
        self.assertEqual(solution.sources[0].star.name, raw["sources"][0]["star"]["name"])
        self.assertEqual(solution.place.latitude_deg, -77.85)
        self.assertEqual(solution.captured, datetime(2026, 12, 20, tzinfo=UTC))
        self.assertEqual((solution.boot, solution.line), (0x26DAE556, 1))
        self.assertAlmostEqual(solution.pointing_error_arcsec, (raw["sigma_east_arcsec"] + raw["sigma_north_arcsec"]) / 2)

    def test_unsolved_images_have_no_pointing_and_a_reason(self):
        by_reason = {s.reason: s for s in starslog.get_solutions(MADE) if not s.solved}
        self.assertEqual(by_reason.keys(), {"no_match", "failed", "unreadable", "undecided"})
        trailed = by_reason["no_match"]
        self.assertEqual((trailed.cause, trailed.ra_deg, trailed.matches), ("trailed", None, []))
        self.assertIsNone(trailed.pointing_error_arcsec)
        self.assertGreater(trailed.blur_px, 50)
        self.assertEqual(by_reason["undecided"].candidate.matched, 21)
        self.assertIsNone(by_reason["unreadable"].captured)
        self.assertIsNone(by_reason["unreadable"].photometry())
        self.assertEqual(trailed.fitted_positions(), {})

    def test_unknown_fields_are_kept_and_absent_ones_not_made_up(self):
        raw = solved(weather={"snow": [1, None]})
        raw["sources"][0]["colour"] = "red"
        del raw["detail"], raw["stats"]["gain"]
        (solution,) = starslog.get_solutions(self.write([raw]))
        self.assertEqual(solution.to_dict(), raw)
        self.assertEqual((solution.extra, solution.sources[0].extra), ({"weather": {"snow": [1, None]}}, {"colour": "red"}))
        self.assertEqual((solution.detail, solution.stats.gain), ("", None))

    def test_objects_are_equal_where_their_fields_are(self):
        path = self.write([solved(), solved(), solved(roll_deg=1.0), solved(new=1)])
        first, same, other, newer = starslog.get_solutions(path)
        self.assertEqual(first, same)
        self.assertNotEqual(first, other)
        self.assertNotEqual(first, newer)

    def test_a_change_of_an_attribute_is_in_the_dict(self):
        (solution,) = starslog.get_solutions(self.write([solved()]))
        solution.sources[0].star.name = "Polaris"
        self.assertEqual(solution.to_dict()["sources"][0]["star"]["name"], "Polaris")

    def test_an_object_may_be_made_by_hand(self):
        made = starslog.Solution(image="a", solved=False, reason="skipped")
        self.assertEqual(starslog.Solution.from_dict(made.to_dict()), made)

    def test_fitted_positions_are_at_the_residual_from_their_sources(self):
        off = []
        for solution in starslog.matched_solutions(self.write(made()).parent):
            fitted = solution.fitted_positions()
            for source, star in solution.matches:
                off.append(abs(math.dist(fitted[source.id], (source.x, source.y)) - star.residual_px))
        self.assertGreater(len(off), 12)
        self.assertLess(statistics.median(off), 0.02)
        self.assertLess(max(off), 0.15)

    def test_photometry_leaves_out_saturated_stars(self):
        raw = solved()
        for source in raw["sources"]:
            source["flux"], source["star"] = 100.0, source["star"] or {"id": 1}
            source["star"]["mag"] = 5.0
        raw["sources"][0] |= {"saturated": True, "flux": 1.0}
        raw["sources"][1]["star"]["mag"] = None
        (solution,) = starslog.get_solutions(self.write([raw]))
        self.assertEqual(solution.photometry(), (10.0, len(raw["sources"]) - 2, 2))


class Damages(WithDirectory):
    """Lines that cannot be read."""

    def test_a_torn_last_line_is_told_and_the_rest_is_read(self):
        torn = as_line(solved())[:700]
        path = self.write(made(), end=torn)
        log = starslog.read_log(path)
        self.assertEqual([s.to_dict() for s in log.solutions], made())
        (damage,) = log.damaged
        self.assertEqual((damage.path, damage.line, damage.content), (path, len(made()) + 1, torn))
        self.assertIn("torn: the file ends within this line, after 700 bytes", str(damage))
        with self.assertWarnsRegex(starslog.DamagedLog, "torn"):
            self.assertEqual(len(starslog.get_solutions(path)), len(made()))

    def test_a_cut_anywhere_loses_the_last_line_alone(self):
        whole = as_line(solved(sources=[], triangles=[], image="σ"))
        for cut in (*range(1, 24), *range(24, len(whole), 29), len(whole) - 2, len(whole) - 1):
            log = starslog.read_log(self.write([solved()], end=whole[:cut]))
            # A line that lacks nothing but its end is whole.
            wanted = (2, 0) if cut == len(whole) - 1 else (1, 1)
            self.assertEqual((len(log.solutions), len(log.damaged)), wanted, cut)

    def test_a_damaged_line_in_the_middle_is_told(self):
        middle = [b'{"image": "a", "solv\n', b"\0\0\0\0\n", b"\xff\xfe\n", b"[1]\n", b"{}\n", b"[" * 100_000 + b"\n", b"\n"]
        for damage in middle:
            log = starslog.read_log(self.write([solved()], end=damage + as_line(solved(image="after"))))
            self.assertEqual([s.image for s in log.solutions][1:], ["after"])
            self.assertEqual([d.line for d in log.damaged], [] if damage == b"\n" else [2], damage[:20])
            self.assertFalse(any("torn" in d.why for d in log.damaged))

    def test_a_value_of_the_wrong_kind_is_told_with_its_place(self):
        for change, why in (
            ({"sources": [{"id": 0, "x": "left"}]}, r"sources\[0\].x is 'left', not float"),
            ({"stats": [1]}, "stats is not an object"),
            ({"solved": None}, "solved is None, not bool"),
            ({"matched": True}, "matched is True, not int"),
            ({"triangles": [1]}, r"triangles\[0\] is not a list"),
        ):
            (damage,) = starslog.read_log(self.write([solved(**change)])).damaged
            self.assertRegex(damage.why, why)

    def test_numbers_that_are_none_are_none(self):
        raw = solved(rms_px=None)
        line = as_line(solved(rms_px="R", chi2_per_dof="R")).replace(b'"R"', b"NaN", 1).replace(b'"R"', b"-Infinity")
        null, nan = starslog.get_solutions(self.write([raw], end=line))
        self.assertIsNone(null.rms_px)
        self.assertEqual((nan.rms_px, nan.chi2_per_dof), (None, None))
        self.assertEqual(null.to_dict(), raw)

    def test_other_ends_of_lines_within_text_are_no_ends(self):
        raw = solved(detail="one\u2028two\x85three")
        self.assertEqual([s.to_dict() for s in starslog.get_solutions(self.write([raw]))], [raw])


class Directories(WithDirectory):
    """Directories of logs."""

    def setUp(self):
        super().setUp()
        self.write([solved(image="c")], "outcomes-unset-00000003.jsonl")
        later = [solved(image="b", image_counter=0), made()[0] | {"image": "x/b.fits"}]
        self.write(later, "outcomes-2026-12-20T02-00-00.000-00000001.jsonl")
        self.write([solved(image="a"), solved(image="b", image_counter=7)], "outcomes-2026-12-20T01-00-00.000-00000002.jsonl")
        self.write([solved(image="other")], "notes.jsonl")

    def test_logs_are_read_in_the_order_of_their_times(self):
        self.assertEqual([s.image for s in starslog.get_solutions(self.directory)], ["a", "b", "b", "x/b.fits", "c"])
        self.assertEqual([s.boot for s in starslog.get_solutions(self.directory)], [2, 2, 1, 1, 3])
        self.assertEqual(starslog.get_solutions(str(self.directory)), starslog.get_solutions(self.directory))

    def test_helpers(self):
        self.assertEqual(starslog.last_log(self.directory).name, "outcomes-unset-00000003.jsonl")
        self.assertEqual(starslog.last_solution(self.directory).image, "c")
        self.assertEqual(starslog.last_solution(self.directory, "b").image_counter, 0)
        self.assertEqual(starslog.last_solution(self.directory, "b.fits").reason, made()[0]["reason"])
        self.assertIsNone(starslog.last_solution(self.directory, "none"))
        self.assertEqual([s.image for s in starslog.matched_solutions(self.directory)], ["a", "b", "b", "c"])

    def test_what_is_not_there_is_an_error(self):
        (self.directory / "empty").mkdir()
        with self.assertRaisesRegex(starslog.LogError, "no outcomes"):
            starslog.get_solutions(self.directory / "empty")
        with self.assertRaisesRegex(starslog.LogError, "no such file"):
            starslog.get_solutions(self.directory / "nowhere")

    def test_whole_logs_do_not_warn(self):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            starslog.get_solutions(self.directory)
