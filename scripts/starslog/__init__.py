"""Reads the outcome logs of the star camera, for analysis after the flight. See README.md.

Needs the standard library alone; tables need pandas, Parquet pyarrow too, and plots matplotlib.
"""

from .fits import kept_images, read_header
from .logs import (
    Damage, DamagedLog, Log, LogError, get_solutions, last_log, last_solution, matched_solutions, outcome_files, read_log,
)
from .needs import MissingPackage
from .outcome import (
    AttitudePrior, Candidate, NotAnOutcome, Observer, Photometry, Prior, Solution, Source, Star, Statistics, Times,
)
from .tables import sources_to_dataframe, to_dataframe, to_parquet

__all__ = [
    "AttitudePrior", "Candidate", "Damage", "DamagedLog", "Log", "LogError", "MissingPackage", "NotAnOutcome", "Observer",
    "Photometry", "Prior", "Solution", "Source", "Star", "Statistics", "Times", "get_solutions", "kept_images", "last_log",
    "last_solution", "matched_solutions", "outcome_files", "read_header", "read_log", "sources_to_dataframe", "to_dataframe",
    "to_parquet",
]
