"""Frozen, validated configuration: clear one-line errors, TOML in and out."""

from __future__ import annotations

import difflib
from pathlib import Path
from typing import Any, Self, get_args

import tomlkit
from pydantic import BaseModel, ConfigDict, ValidationError
from tomlkit.items import Table

from driftcore.errors import ScenarioError


class Configuration(BaseModel):
    """Base of every configuration: frozen, no unknown keys, no NaN.

    Raises
    ------
    ScenarioError
        A value is not accepted; the message names the field, the value and what is.
    """

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, arbitrary_types_allowed=True
    )

    def __init__(self, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise ScenarioError("; ".join(_sentences(type(self), error))) from None

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
        import tomllib

        name = "TOML text"
        text = source
        if isinstance(source, Path):
            name = str(source)
            try:
                text = source.read_text(encoding="utf-8")
            except FileNotFoundError:
                raise ScenarioError(f"{source}: no such file") from None
            except (OSError, UnicodeDecodeError) as error:
                raise ScenarioError(f"{source}: cannot be read: {error}") from None
        try:
            values = tomllib.loads(str(text))
        except (tomllib.TOMLDecodeError, RecursionError) as error:
            raise ScenarioError(f"{name}: not valid TOML: {error}") from None
        return cls(**values)

    def to_toml(self) -> str:
        """Write as TOML, each field with its description as a comment."""
        document = tomlkit.document()
        _fill(document, self)
        return tomlkit.dumps(document)


def _fill(table: tomlkit.TOMLDocument | Table, configuration: Configuration) -> None:
    """Plain values first, then the sub-tables, as TOML needs."""
    nested = []
    for name, field in type(configuration).model_fields.items():
        value = getattr(configuration, name)
        comment = field.description
        if isinstance(value, Configuration):
            nested.append((name, value, comment))
            continue
        if value is None:
            table.add(tomlkit.comment(f"{name} =   # {comment}"))
            continue
        try:
            item = tomlkit.item(_plain(value))
        except ValueError:
            # Arrays given in Python: named, so that reading this back fails instead of differing.
            item = tomlkit.item(repr(value))
        if comment:
            item.comment(comment)
        table.add(name, item)
    for name, value, comment in nested:
        inner = tomlkit.table()
        if comment:
            inner.comment(comment)
        _fill(inner, value)
        table.add(tomlkit.nl())
        table.add(name, inner)


def _plain(value: Any) -> Any:
    return [_plain(part) for part in value] if isinstance(value, tuple) else value


def _sentences(model: type[BaseModel], error: ValidationError) -> list[str]:
    sentences = []
    for problem in error.errors():
        where = ".".join(str(part) for part in problem["loc"])
        cause = problem.get("ctx", {}).get("error")
        if isinstance(cause, ScenarioError):
            # An inner configuration has told its own sentence; put the path before it.
            sentences.append(f"{where}.{cause}" if where else str(cause))
        elif problem["type"] == "extra_forbidden":
            known = _fields_at(model, problem["loc"][:-1])
            close = difflib.get_close_matches(str(problem["loc"][-1]), known, n=1)
            hint = f"did you mean '{close[0]}'?" if close else f"known: {', '.join(known)}"
            sentences.append(f"{where}: unknown key; {hint}")
        else:
            sentences.append(
                f"{where}: {_shown(problem['input'])} is not accepted; {_reason(problem['msg'])}"
            )
    return sentences


def _fields_at(model: type[BaseModel], path: tuple[int | str, ...]) -> list[str]:
    for part in path:
        field = model.model_fields.get(str(part))
        choices = [] if field is None else [field.annotation, *get_args(field.annotation)]
        inner = [c for c in choices if isinstance(c, type) and issubclass(c, BaseModel)]
        if not inner:
            continue
        model = inner[0]
    return list(model.model_fields)


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}…"


def _reason(message: str) -> str:
    message = message.removeprefix("Value error, ").removeprefix("Input ")
    return f"it {message}" if message.startswith("should") else message
