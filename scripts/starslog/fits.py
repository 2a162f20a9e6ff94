"""Headers of the images that the service keeps beside its logs, from the standard library alone."""

import re
from pathlib import Path

CARD, BLOCK = 80, 2880
# A header longer than this is not one.
MAX_BLOCKS = 1000
# <time>-<boot>-<counter>.fits in a directory for each day; see `kept_images`.
NAME = re.compile(r"-([0-9a-f]{8})-(\d{8,})\.fits$")

Value = str | int | float | bool


class NotFits(ValueError):
    """The file has no FITS header."""


def read_header(path: str | Path) -> dict[str, Value]:
    """The first header of a FITS file: values by keyword, `HIERARCH` or not. What its comment calls UNKNOWN is left out."""
    header: dict[str, Value] = {}
    with Path(path).open("rb") as file:
        for _ in range(MAX_BLOCKS):
            block = file.read(BLOCK)
            cards = [block[i : i + CARD].decode("latin-1") for i in range(0, len(block), CARD)]
            if not header and not (cards and cards[0].startswith("SIMPLE  =")):
                break
            for card in cards:
                if card.startswith("END     "):
                    return header
                add_card(header, card)
    raise NotFits(f"{path}: no FITS header")


def add_card(header, card):
    """Adds what a card says; the first one of a keyword counts."""
    name, equals, rest = card.removeprefix("HIERARCH ").partition("=")
    is_long = card.startswith("HIERARCH ")
    if not equals or (not is_long and len(name) != 8):
        return
    value, comment = parse_value(rest.strip())
    if value is not None and "UNKNOWN" not in comment.upper():
        header.setdefault(name.strip(), value)


def parse_value(text):
    """Value and comment of a card; the value is None where there is none that makes sense."""
    # A quote inside a string is written twice.
    if quoted := re.match(r"'((?:[^']|'')*)'(.*)", text):
        return quoted[1].replace("''", "'").rstrip(), quoted[2].partition("/")[2].strip()
    word, _, comment = text.partition("/")
    return number(word.strip()), comment.strip()


def number(word):
    """A number, or true or false."""
    if word in ("T", "F"):
        return word == "T"
    if re.fullmatch(r"[+-]?\d+", word):
        return int(word)
    # FITS may write the exponent of a double with D.
    return float(word.replace("D", "E")) if re.fullmatch(r"[+-]?(\d+\.?\d*|\.\d+)([ED][+-]?\d+)?", word) else None


def kept_images(directory: str | Path) -> dict[tuple[int, int], Path]:
    """The images kept beside the logs of a directory, by number of the start and counter of the image (`Solution.boot`,
    `Solution.image_counter`). Older ones were thinned out, so that most images have none."""
    images = {}
    for path in sorted(Path(directory).glob("images/*/*.fits")):
        if found := NAME.search(path.name):
            images[int(found[1], 16), int(found[2])] = path
    return images


def header_of(solution, images: dict[tuple[int, int], Path]) -> dict[str, Value]:
    """The header of a solution's image: the one kept, else the file that it was read from; empty where neither is there."""
    path = images.get((solution.boot, solution.image_counter)) or Path(solution.image)
    try:
        return read_header(path) if path.suffix in (".fits", ".fit", ".fts") else {}
    except (OSError, NotFits):
        return {}
