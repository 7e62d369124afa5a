"""Options of methods as pydantic models, and conversion of pydantic's errors to errors for users.

The command line, Python, study files, recipes and frame files use both.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from typing import Any, Literal, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, Field, SerializerFunctionWrapHandler, ValidationError, model_serializer

from p2o.errors import InputError, UnknownNameError

_Model = TypeVar("_Model", bound=BaseModel)
_BOUNDS = {"gt", "ge", "lt", "le", "multiple_of", "min_length", "max_length", "error"}
"""Keys in the context of pydantic errors of bounds and of own validators."""


class Options(BaseModel):
    """Base of the options of methods: frozen, without unknown names, with validated defaults."""

    model_config = ConfigDict(frozen=True, extra="forbid", validate_default=True, allow_inf_nan=False)

    @model_serializer(mode="wrap", when_used="json")
    def _with_sets_in_order(self, serialize: SerializerFunctionWrapHandler) -> Any:
        """Return plain values with sets in order: the order of Python, and keys of rows with it, differ by process."""
        plain = serialize(self)
        for name in type(self).model_fields:
            if isinstance(getattr(self, name), Set) and isinstance(plain.get(name), list):
                plain[name].sort(key=repr)
        return plain


def field(default: Any, *, help: str, **bounds: Any) -> Any:
    """Return an option field: a default, bounds (gt, ge, lt, le, ...) and a description of one sentence for users."""
    return Field(default, description=help, **bounds)


@dataclass(frozen=True)
class Fault:
    """The first fault of a value: the path of keys to it, its kind, the expected and the actual value.

    `known` are the valid keys for an unknown one; `more` is the number of further faults.
    """

    path: tuple[str | int, ...]
    sort: Literal["unknown", "missing", "bound", "value"]
    expected: str
    got: str
    known: tuple[str, ...]
    more: int

    def error(self, within: str = "", *, where: object = None, noun: str = "key") -> InputError:
        """Return the error to raise: `within` is the beginning of the path, `noun` the kind of an unknown name."""
        if self.sort == "unknown":
            return UnknownNameError(noun, str(self.path[-1]), self.known, where=where)
        name = ".".join(str(part) for part in ((within, *self.path) if within else self.path)) or "the value"
        if self.sort == "missing":
            return InputError(f"{name} is missing", where=where, expected="a value: it has no default")
        return InputError(
            f"{name} is out of bounds" if self.sort == "bound" else f"{name} is not valid",
            where=where,
            expected=self.expected,
            got=self.got if self.path else None,
            hint=f"{self.more} further faults" if self.more else None,
        )


def validated(
    model: type[_Model], values: Any, within: str = "", *, where: object = None, noun: str | None = None
) -> _Model:
    """Return the model of these values; `within` is the beginning of paths in errors, `where` the place.

    Raises UnknownNameError for an unknown key, and InputError with path, value and bound for other faults and for texts
    with lone surrogates.
    """
    try:
        return model.model_validate(dict(values) if isinstance(values, Mapping) else values)
    except UnicodeEncodeError as problem:  # JSON may contain escaped lone surrogates
        raise InputError("a text contains a lone surrogate", where=where, got=problem.object) from problem
    except ValidationError as problem:
        noun = noun or (f"{within} option" if within else "key")
        raise fault_of(problem, model, values).error(within, where=where, noun=noun) from problem


def fault_of(problem: ValidationError, model: type[BaseModel], values: Any) -> Fault:
    """Return the first fault that pydantic found in `values`."""
    first = problem.errors()[0]
    path, level = _followed(first["loc"], model, values)
    sorts: dict[str, Literal["unknown", "missing"]] = {"extra_forbidden": "unknown", "missing": "missing"}
    message = first["msg"].removeprefix("Value error, ").removeprefix("Input should be ")
    return Fault(
        path=path,
        sort=sorts.get(first["type"], "bound" if _BOUNDS & first.get("ctx", {}).keys() else "value"),
        expected=message[:1].lower() + message[1:],
        got=str(first["input"])[:80] or "nothing",
        known=tuple(level.model_fields),
        more=len(problem.errors()) - 1,
    )


def _followed(
    loc: Sequence[str | int], model: type[BaseModel], values: Any
) -> tuple[tuple[str | int, ...], type[BaseModel]]:
    """Return the keys in `loc` (also names of pydantic) that exist in `values` or are fields, and their model."""
    path: list[str | int] = []
    level = model
    for part in loc:
        inside: Any = None
        if isinstance(values, list | tuple) and isinstance(part, int):
            inside = values[part] if part < len(values) else None
        elif part in level.model_fields:
            level = next(_models(level.model_fields[str(part)].annotation), level)
            inside = values.get(part) if isinstance(values, Mapping) else None
        elif isinstance(values, Mapping) and part in values:
            inside = values[part]
        else:
            continue
        path.append(part)
        values = inside
    return tuple(path), level


def _models(annotation: Any) -> Iterator[type[BaseModel]]:
    """Yield the models in a type annotation."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from _models(part)
