"""JSON objects as dataclasses, without loss.

Each known key is an attribute of the same name. A key that is not known here, of a newer program say, is kept in `extra`; one
that is not in the object is left out again by `to_dict()`. So `Record.from_dict(d).to_dict() == d`, whatever wrote `d`.
"""

from dataclasses import MISSING, dataclass, field, fields
from functools import cache
from typing import Any, Self, get_args, get_origin

NOT_JSON = {"json": False}


class WrongShape(ValueError):
    """A value is not of the kind that its key has; says where."""


@dataclass(kw_only=True, slots=True)
class Record:
    """What all objects of a log have."""

    # Keys unknown to this class, and their values as they are.
    extra: dict[str, Any] = field(default_factory=dict, repr=False, metadata=NOT_JSON)
    # The keys of the object that this was read from, in their order; None where it was read from none.
    keys: tuple[str, ...] | None = field(default=None, repr=False, compare=False, metadata=NOT_JSON)

    @classmethod
    def from_dict(cls, data: dict[str, Any], place: str = "") -> Self:
        """Of a JSON object; `place`: where it stands, for errors."""
        if type(data) is not dict:
            raise WrongShape(f"{place or 'the line'} is not an object")
        known, extra = {}, {}
        readers = readers_of(cls)
        for key, value in data.items():
            if reader := readers.get(key):
                known[key] = reader(value, f"{place}.{key}" if place else key)
            else:
                extra[key] = value
        for name in required(cls):
            if name not in known:
                raise WrongShape(f"{place or 'the line'} has no {name}")
        return cls(**known, extra=extra, keys=tuple(data))

    def to_dict(self) -> dict[str, Any]:
        """The JSON object, made from the attributes: equal to what was read, where nobody changed them."""
        keys = self.keys if self.keys is not None else (*readers_of(type(self)), *self.extra)
        return {key: plain(self.extra[key] if key in self.extra else getattr(self, key)) for key in keys}


def plain(value):
    """A value as JSON has it."""
    if isinstance(value, Record):
        return value.to_dict()
    return [plain(item) for item in value] if isinstance(value, list) else value


def json_fields(cls):
    """The fields of a record that are keys of its object."""
    return [f for f in fields(cls) if f.metadata.get("json", True)]


@cache
def required(cls):
    """Keys without which an object is something else."""
    return tuple(f.name for f in json_fields(cls) if f.default is MISSING and f.default_factory is MISSING)


@cache
def readers_of(cls):
    """For each key what turns its value into the attribute."""
    return {f.name: reader_of(f.type) for f in json_fields(cls)}


def kinds_of(hint):
    """The types that an attribute may have: `float | None` has two."""
    return get_args(hint) if get_origin(hint) is not list and get_args(hint) else (hint,)


def record_of(hint):
    """The record that an attribute may be; None where it is something else."""
    return next((kind for kind in kinds_of(hint) if isinstance(kind, type) and issubclass(kind, Record)), None)


def reader_of(hint):
    """What checks a value and turns it into an attribute of this type."""
    kinds = kinds_of(hint)
    may_be_null = type(None) in kinds
    if record := record_of(hint):
        return lambda value, place: None if value is None and may_be_null else record.from_dict(value, place)
    (kind,) = (kind for kind in kinds if kind is not type(None))
    if get_origin(kind) is list:
        return list_reader(get_args(kind)[0], may_be_null)
    # A number without a fraction may be written as a whole one. What is true or false is no number, though Python counts with it.
    allowed = {kind} | ({int} if kind is float else set()) | ({type(None)} if may_be_null else set())

    def read(value, place):
        if type(value) not in allowed:
            raise WrongShape(f"{place} is {value!r:.40}, not {kind.__name__}")
        return value

    return read


def list_reader(item, may_be_null):
    """What checks a list and turns each of its items."""
    read_item = reader_of(item)

    def read(value, place):
        if value is None and may_be_null:
            return None
        if type(value) is not list:
            raise WrongShape(f"{place} is not a list")
        return [read_item(each, f"{place}[{i}]") for i, each in enumerate(value)]

    return read
