"""Frozen, validated configuration: clear one-line errors, TOML in and out."""

from __future__ import annotations

import difflib
import json
import re
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Self, Union, get_args, get_origin

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError, model_validator

from driftcore.errors import ScenarioError

# What stands in TOML, which has no null, where a default is switched off.
NOTHING = "none"
# Between the sentences of one error: no value holds it, for values are shown by their repr.
_SEPARATOR = ";\n"
_JSON = json.JSONEncoder(ensure_ascii=False)
_BARE_KEY = re.compile("[A-Za-z0-9_-]+")
# The validator's words for what TOML calls otherwise.
_WORDS = (
    ("Input ", "it "),
    ("Tuple ", "it "),
    (" after validation", ""),
    ("valid tuple", "list"),
    ("valid dictionary", "table"),
)


class Configuration(BaseModel):
    """Base of every configuration: frozen, no unknown keys, no NaN, no text for a number.

    Raises
    ------
    ScenarioError
        A value is not accepted; the message names the field, the value and what is.
    """

    model_config = ConfigDict(
        frozen=True,
        strict=True,
        extra="forbid",
        allow_inf_nan=False,
        arbitrary_types_allowed=True,
    )

    def __init__(self, /, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise ScenarioError(_SEPARATOR.join(_sentences(type(self), error))) from None

    @model_validator(mode="before")
    @classmethod
    def _strict_types(cls, values: Any) -> Any:
        if not isinstance(values, dict):
            return values
        return {name: _strict(value) for name, value in values.items()}

    def replace(self, **changes: Any) -> Self:
        """Give a copy with some fields changed, validated anew."""
        return type(self)(**{**dict(self), **changes})

    @classmethod
    def from_toml(cls, source: str | Path) -> Self:
        """Read TOML: text, or the path of a file.

        Raises
        ------
        ScenarioError
            The file is missing or not TOML (with the line), or a value is not accepted.
        """
        return cls(**read_toml(source))

    def in_toml(self, name: str) -> Any:
        """Give the value of a field as it is written in TOML."""
        return getattr(self, name)

    def to_toml(self) -> str:
        """Write as TOML, each field with its description as a comment."""
        return "\n".join(_lines(self)).lstrip() + "\n"


def read_toml(source: str | Path) -> dict[str, Any]:
    """Read the values of TOML: text, or the path of a file.

    Raises
    ------
    ScenarioError
        The file is missing or not TOML (with the line).
    """
    import tomllib

    name = "TOML text (a file is named by a Path)"
    text = source
    if isinstance(source, Path):
        name = str(source)
        try:
            text = source.read_text(encoding="utf-8-sig")
        except FileNotFoundError:
            raise ScenarioError(f"{source}: no such file") from None
        except OSError as error:
            raise ScenarioError(f"{source}: cannot be read: {error.strerror}") from None
        except ValueError as error:
            raise ScenarioError(f"{source}: is not UTF-8 text: {error}") from None
    try:
        return tomllib.loads(str(text))
    except (ValueError, RecursionError) as error:
        raise ScenarioError(f"{name}: not valid TOML: {error}") from None


def _lines(configuration: Configuration, path: str = "") -> Iterator[str]:
    """Lines of TOML: plain values first, then the sub-tables, as TOML needs."""
    nested: list[tuple[str, Any, str | None]] = []
    for name, field in type(configuration).model_fields.items():
        value = configuration.in_toml(name)
        comment = field.description
        if _is_table(value):
            nested.append((name, value, comment))
        elif value == field.default and value in (None, {}, ()):
            tables = _tables(field.annotation)
            if nested or tables:  # what is absent here is a table too
                nested.append((name, tables, comment))
            else:
                yield f"# {name} =   # {comment}"
        else:
            yield f"{name} = {_written(NOTHING if value is None else value)}{_commented(comment)}"
    for name, value, comment in nested:
        yield ""
        if isinstance(value, list):
            several = type(configuration).model_fields[name].default == ()
            header = f"[[{name}]]" if several else f"[{name}]"
            yield f"# {header}   # {comment}"
            yield from (f"# {line}" for line in _explained(value))
        else:
            yield from _table(f"{path}{name}", value, comment)


def _table(path: str, value: Any, comment: str | None) -> Iterator[str]:
    """Lines of a table, or of several of a name."""
    if isinstance(value, tuple):
        for k, part in enumerate(value):
            yield from [""] * (k > 0)
            yield f"[[{path}]]"
            yield from _lines(part, f"{path}.")
        return
    if isinstance(value, Configuration) or not all(map(_is_table, value.values())):
        yield f"[{path}]{_commented(comment)}"
    if isinstance(value, Configuration):
        yield from _lines(value, f"{path}.")
        return
    for key, part in value.items():
        key = key if _BARE_KEY.fullmatch(key) else _written(key)
        if _is_table(part):
            yield ""
            yield from _table(f"{path}.{key}", part, None)
        else:
            yield f"{key} = {_written(part)}"


def _commented(comment: str | None) -> str:
    return f" # {comment}" if comment else ""


def _is_table(value: Any) -> bool:
    """Whether TOML writes a value as a table, or as several of a name."""
    if isinstance(value, tuple):
        return bool(value) and isinstance(value[0], Configuration)
    return isinstance(value, Configuration) or bool(isinstance(value, dict) and value)


def _tables(annotation: Any) -> list[type[Configuration]]:
    """Find the configurations that a field may hold by itself."""
    if isinstance(annotation, type) and issubclass(annotation, Configuration):
        return [annotation]
    if get_origin(annotation) in (Union, UnionType, Annotated):
        return [table for part in get_args(annotation) for table in _tables(part)]
    return []


def _explained(tables: list[type[Configuration]]) -> Iterator[str]:
    """Lines that stand, as comments, for tables that are absent: their fields and defaults."""
    for table in tables[:1]:
        for name, field in table.model_fields.items():
            unset = field.is_required() or field.default in (None, {})
            value = "" if unset else f" {_written(field.default)}"
            comment = f"   # {field.description}" if field.description else ""
            yield f"{name} ={value}{comment}"


def _written(value: Any) -> str:
    """Write a value: as JSON does, which is TOML too but for one character."""
    if isinstance(value, datetime):
        return value.isoformat().replace("+00:00", "Z")
    try:
        text = _JSON.encode(value)
    except TypeError:
        # Arrays given in Python: named, so that reading this back fails instead of differing.
        text = _JSON.encode(repr(value))
    return text.replace("\x7f", "\\u007f")


def _plain(value: Any) -> Any:
    return [_plain(part) for part in value] if isinstance(value, tuple) else value


def _strict(value: Any) -> Any:
    """Make lists tuples and NumPy's numbers Python's, as strict validation asks for."""
    if isinstance(value, np.generic) and not isinstance(value, np.datetime64):
        return value.item()
    if isinstance(value, dict):
        return {name: _strict(part) for name, part in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return tuple(_strict(part) for part in value)
    return value


def _sentences(model: type[BaseModel], error: ValidationError) -> Iterator[str]:
    problems = error.errors()
    for problem in problems:
        kind, location, context = problem["type"], problem["loc"], problem.get("ctx", {})
        where = _where(model, location)
        cause = context.get("error")
        if isinstance(cause, ScenarioError):
            # An inner configuration has told its own sentences; put the path before them.
            path = f"{where}." if where else ""
            yield from (path + sentence for sentence in str(cause).split(_SEPARATOR))
        elif cause is not None:
            yield f"{where}: {cause}" if where else str(cause)
        elif kind == "missing":
            yield f"{where}: is missing"
        elif kind == "extra_forbidden":
            known = list(model.model_fields)
            close = difflib.get_close_matches(where, known, n=1)
            hint = f"did you mean '{close[0]}'?" if close else f"known: {', '.join(known)}"
            yield f"{where}: unknown key; {hint}"
        elif kind == "union_tag_invalid":
            known = context["expected_tags"].replace(", ", " or ")
            yield f"{where}.kind: {context['tag']!r} is not accepted; it should be {known}"
        elif kind == "too_short" and any(
            p["loc"][: len(location)] == location for p in problems if len(p["loc"]) > len(location)
        ):
            continue  # only because another sentence refuses its parts
        else:
            yield f"{where}: {_shown(problem['input'])} is not accepted; {_reason(problem['msg'])}"


def _where(model: type[BaseModel], location: tuple[int | str, ...]) -> str:
    """Path as a user writes it: without the tag that follows a union, which is no key."""
    tagged = location and getattr(model.model_fields.get(str(location[0])), "discriminator", None)
    return ".".join(str(part) for k, part in enumerate(location) if not (tagged and k == 1))


def _shown(value: Any) -> str:
    text = repr(_plain(value))
    return text if len(text) <= 60 else f"{text[:57]}…"


def _reason(message: str) -> str:
    """Tell a message of the validator in the words of TOML."""
    message = re.sub(r" or (instance of \w+|object to extract fields from)$", "", message)
    message = message.removesuffix(", unable to parse string as a number")
    for theirs, ours in _WORDS:
        message = message.replace(theirs, ours)
    return message
