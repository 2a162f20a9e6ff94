"""Outcomes as tables: a row for each image, or for each source. Needs pandas; Parquet needs pyarrow too."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from .needs import need
from .outcome import Solution, Source
from .record import json_fields, kinds_of, record_of

if TYPE_CHECKING:
    import pandas

AXES = ("east", "north", "roll")
# Lists that are no column of their own.
LISTS = {"sources", "triangles", "covariance_arcsec2", "level", "corrections"}
# The same whether values are missing or not, so that tables can be joined. Missing: NaN for a real number, else <NA>.
DTYPES = {float: "float64", int: "Int64", bool: "boolean", str: "string"}


def to_dataframe(solutions: Iterable[Solution]) -> "pandas.DataFrame":
    """A row for each image, indexed by the UTC of the middle of its exposure (NaT where that is not known).

    Nested fields are flattened: `stats_mean`, `prior_attitude_ra_deg`, `covariance_arcsec2_east_north`. Sources have a table of
    their own, and of the triangles there is only how many.
    """
    return table((with_origin(solution, frame_row(solution)) for solution in solutions), frame_types())


def sources_to_dataframe(solutions: Iterable[Solution]) -> "pandas.DataFrame":
    """A row for each source of each image, indexed as the images are; fields of its star begin with `star_`."""
    types = {"image": str, "image_counter": int} | flat_types(Source)
    rows = (
        with_origin(solution, {"image": solution.image, "image_counter": solution.image_counter} | flat(source, Source))
        for solution in solutions
        for source in solution.sources
    )
    return table(rows, types)


def to_parquet(solutions: Iterable[Solution], path: str | Path, sources: str | Path | None = None) -> None:
    """Writes the table of images as Parquet, and that of sources where a file for it is named."""
    need("pyarrow", "Parquet")
    solutions = list(solutions)
    to_dataframe(solutions).to_parquet(path, engine="pyarrow")
    if sources is not None:
        sources_to_dataframe(solutions).to_parquet(sources, engine="pyarrow")


def table(rows, types):
    """Rows as a DataFrame with columns of these types, and after them those that only some rows have."""
    pandas = need("pandas", "a table")
    rows = list(rows)
    types = types | {"log": str, "line": int, "boot": int}
    others = dict.fromkeys(key for row in rows for key in row if key not in types and key != "utc")
    columns = {name: pandas.array([row.get(name) for row in rows], dtype=DTYPES[kind]) for name, kind in types.items()}
    columns |= {name: pandas.Series([row.get(name) for row in rows]).convert_dtypes().array for name in others}
    index = pandas.DatetimeIndex(pandas.to_datetime([row["utc"] for row in rows], utc=True), name="utc").as_unit("ms")
    return pandas.DataFrame(columns, index=index)


def with_origin(solution, row):
    """A row with its time, and where it was read from."""
    name = solution.log and str(solution.log)
    return row | {"utc": solution.captured, "log": name, "line": solution.line, "boot": solution.boot}


def frame_row(solution):
    """The fields of an image."""
    row = flat(solution, Solution)
    for i, one in enumerate(AXES):
        for j, other in enumerate(AXES[i:], start=i):
            row[f"covariance_arcsec2_{one}_{other}"] = solution.covariance_arcsec2 and solution.covariance_arcsec2[i][j]
    low, high = (solution.stats and solution.stats.level) or (None, None)
    return row | {
        "stats_level_low": low,
        "stats_level_high": high,
        "pointing_error_arcsec": solution.pointing_error_arcsec,
        "triangles": len(solution.triangles),
        "corrections": " ".join(solution.corrections),
    }


def frame_types():
    """The columns of an image and their types."""
    covariance = {f"covariance_arcsec2_{one}_{other}": float for i, one in enumerate(AXES) for other in AXES[i:]}
    derived = {"pointing_error_arcsec": float, "triangles": int, "corrections": str}
    return flat_types(Solution) | covariance | {"stats_level_low": int, "stats_level_high": int} | derived


def flat_types(cls, prefix=""):
    """The columns of a record and their types; those of a record in it have its name in front."""
    types = {}
    for f in json_fields(cls):
        if nested := record_of(f.type):
            types |= flat_types(nested, f"{prefix}{f.name}_")
        elif f.name not in LISTS:
            (types[prefix + f.name],) = (kind for kind in kinds_of(f.type) if kind is not type(None))
    return types


def flat(record, cls, prefix=""):
    """The values of a record by column; none of one that is not there."""
    if record is None:
        return {}
    row = {prefix + key: value for key, value in flat_extra(record.extra).items()}
    for f in json_fields(cls):
        value = getattr(record, f.name)
        if nested := record_of(f.type):
            row |= flat(value, nested, f"{prefix}{f.name}_")
        elif f.name not in LISTS:
            row[prefix + f.name] = value
    return row


def flat_extra(values, prefix=""):
    """Fields unknown to this package: objects flattened, lists as JSON."""
    row = {}
    for key, value in values.items():
        if isinstance(value, dict):
            row |= flat_extra(value, f"{prefix}{key}_")
        else:
            row[prefix + key] = json.dumps(value, ensure_ascii=False) if isinstance(value, list) else value
    return row
