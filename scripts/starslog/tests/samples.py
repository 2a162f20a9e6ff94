"""Logs for the tests: lines that the program made, their lists shortened, and directories of them."""

import copy
import json
import tempfile
import unittest
from pathlib import Path

MADE = Path(__file__).with_name("made_by_stars.jsonl")


def made():
    """Outcomes as the program wrote them: trailed, three solved (two by the service), broken, unreadable, undecided."""
    return [json.loads(line) for line in MADE.read_text().split("\n") if line]


def solved(**changes):
    """A solved image of the service, changed."""
    outcome = next(o for o in made() if o["solved"] and o["captured_utc"])
    return copy.deepcopy(outcome) | changes


def as_line(outcome):
    """An outcome as a line of a log."""
    return json.dumps(outcome, separators=(",", ":"), ensure_ascii=False).encode() + b"\n"


class WithDirectory(unittest.TestCase):
    """Tests that have a directory of their own."""

    def setUp(self):
        held = tempfile.TemporaryDirectory()
        self.addCleanup(held.cleanup)
        self.directory = Path(held.name)

    def write(self, outcomes, name="outcomes-2026-12-20T00-00-00.000-26dae556.jsonl", end=b""):
        """Writes a log of these outcomes, and bytes after them."""
        path = self.directory / name
        path.write_bytes(b"".join(map(as_line, outcomes)) + end)
        return path
