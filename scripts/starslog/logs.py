"""Finds and reads the service's logs: `outcomes-<time>-<boot>.jsonl`, one for each start of the program, one line for each image.

A power cut can tear the last line. Whatever cannot be read is told, never passed over in silence; an empty line holds nothing.
"""

import json
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from .outcome import Solution
from .record import WrongShape

PATTERN = "outcomes-*.jsonl"
# In the name of a log that was begun before the clock was set.
UNSET = "outcomes-unset-"


class LogError(Exception):
    """There is no log to read."""


class DamagedLog(UserWarning):
    """A line of a log could not be read."""


@dataclass(frozen=True)
class Damage:
    """A line that could not be read."""

    # File, and number of the line from 1.
    path: Path
    line: int
    # What is wrong with it.
    why: str
    # What is there of it.
    content: bytes = field(repr=False)

    def __str__(self):
        return f"{self.path}:{self.line}: {self.why}"


@dataclass
class Log:
    """What logs hold: outcomes in their order, and the lines that could not be read."""

    solutions: list[Solution] = field(default_factory=list)
    damaged: list[Damage] = field(default_factory=list)


def outcome_files(directory: str | Path) -> list[Path]:
    """The logs of a directory, in the order of the times in their names; those begun without a clock come last."""
    return sorted(Path(directory).glob(PATTERN), key=lambda path: (path.name.startswith(UNSET), path.name))


def read_log(path: str | Path) -> Log:
    """Reads a log, or all logs of a directory, and keeps account of what could not be read."""
    log = Log()
    for file in files_of(Path(path)):
        for entry in read_lines(file):
            (log.damaged if isinstance(entry, Damage) else log.solutions).append(entry)
    return log


def get_solutions(path: str | Path) -> list[Solution]:
    """The outcomes of all images in a log, or in all logs of a directory, solved or not, in the order in which they ended.

    Warns (DamagedLog) of each line that could not be read; `read_log` returns these lines.
    """
    log = read_log(path)
    for damage in log.damaged:
        warnings.warn(str(damage), DamagedLog, stacklevel=2)
    return log.solutions


def last_log(directory: str | Path) -> Path:
    """The newest log of a directory."""
    return files_of(Path(directory))[-1]


def last_solution(directory: str | Path, origin: str | None = None) -> Solution | None:
    """The last outcome in a directory's logs, solved or not; with `origin`, the last of that image, by its path or its name."""
    for file in reversed(files_of(Path(directory))):
        for solution in reversed(get_solutions(file)):
            if origin is None or origin in (solution.image, Path(solution.image).name):
                return solution
    return None


def matched_solutions(directory: str | Path) -> list[Solution]:
    """All outcomes with a pointing."""
    return [solution for solution in get_solutions(directory) if solution.solved]


def files_of(path: Path) -> list[Path]:
    """The logs that a path means: itself, or those of a directory."""
    if not path.is_dir():
        if not path.exists():
            raise LogError(f"{path}: there is no such file or directory")
        return [path]
    files = outcome_files(path)
    if not files:
        raise LogError(f"{path}: no {PATTERN} in this directory")
    return files


def read_lines(path: Path) -> Iterator[Solution | Damage]:
    """Each line of a log, as an outcome or as damage."""
    try:
        with path.open("rb") as file:
            # Split at newlines alone: JSON may hold other characters that Python takes for the end of a line.
            for number, line in enumerate(file, start=1):
                if line.strip():
                    yield read_line(path, number, line)
    except OSError as error:
        raise LogError(f"{path}: {error.strerror or error}") from error


def read_line(path: Path, number: int, line: bytes) -> Solution | Damage:
    """One line of a log."""
    try:
        # The service writes null for what is not a number; NaN, of another program, means the same.
        raw = json.loads(line.decode(), parse_constant=lambda _: None)
        solution = Solution.from_dict(raw)
    except UnicodeDecodeError as error:
        return Damage(path, number, torn(line) or f"not UTF-8 at byte {error.start}", line)
    except json.JSONDecodeError as error:
        return Damage(path, number, torn(line) or f"not JSON at character {error.pos}: {error.msg}", line)
    except (WrongShape, RecursionError, ValueError) as error:
        return Damage(path, number, f"not an outcome: {error}", line)
    solution.raw, solution.log, solution.line = raw, path, number
    return solution


def torn(line: bytes) -> str | None:
    """Says so where the file ends within a line."""
    return None if line.endswith(b"\n") else f"torn: the file ends within this line, after {len(line)} bytes"
