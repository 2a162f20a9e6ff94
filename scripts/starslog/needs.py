"""Packages that not every computer has."""

import importlib


class MissingPackage(RuntimeError):
    """A package is missing; says which, and what for."""


def need(package, purpose):
    """Imports a package, or says how to get it."""
    try:
        return importlib.import_module(package)
    except ModuleNotFoundError as error:
        top = (error.name or package).partition(".")[0]
        raise MissingPackage(f"{purpose} needs {top}: python3 -m pip install {top}") from error
