"""Field types of results and stored rows: how pydantic checks values from JSON and writes values as JSON.

JSON has no number that is not finite: NaN is written as null, infinities as the texts "inf" and "-inf".
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from pydantic import ConfigDict, PlainSerializer, PlainValidator, Strict, TypeAdapter, ValidationError
from pydantic_core import CoreSchema, PydanticCustomError, PydanticSerializationError, core_schema

from p2o.arrays import Float, parts
from p2o.errors import InputError
from p2o.geometry import se3


def json_tree(name: str, value: Any) -> Any:
    """Return a value as dicts, lists, finite numbers, texts and None; `name` is what errors call the value.

    Raises InputError for a value that JSON cannot represent, with the path of keys to it.
    """
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    inner = parts(value)
    if inner is not None:
        plain = {str(key): json_tree(f"{name}.{key}", part) for key, part in inner}
        return list(plain.values()) if isinstance(value, list | tuple) else plain
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)
    if isinstance(value, str):
        return str(value)
    if value is None or isinstance(value, bool | int | float):
        return value
    raise InputError(f"{name} has no form in JSON", expected="numbers, texts, lists, dicts", got=type(value).__name__)


def _number(value: Any) -> float:
    """Return a number of JSON as a float, null as NaN."""
    if value is None:
        return math.nan
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not is_number and value not in ("inf", "-inf"):
        raise PydanticCustomError("number", "a number")
    try:
        return float(value)
    except OverflowError as problem:
        raise PydanticCustomError("number", "a number that fits a float") from problem


Number = Annotated[
    float, PlainValidator(_number), PlainSerializer(lambda value: json_tree("a number", float(value)), when_used="json")
]
"""A float that may be NaN or infinite."""
Count = Annotated[int, Strict(), PlainSerializer(int, when_used="json")]
"""An integer; NumPy's integers are written as such."""
Flag = Annotated[bool, Strict(), PlainSerializer(bool, when_used="json")]
"""A boolean; NumPy's booleans are written as such."""
Tree = Annotated[Mapping[str, Any], PlainSerializer(lambda value: json_tree("recipe", value), when_used="json")]
"""A mapping of plain values, such as the recipe of a result."""


@dataclass(frozen=True)
class JsonArray:
    """Annotate a field of type Float: an array of this shape, nested lists in JSON.

    With `rigid` the array has to be a rigid transform to 1e-9; the numbers themselves are kept bit by bit. Without
    `finite` elements may be null (NaN), "inf" and "-inf".
    """

    shape: tuple[int, ...]
    rigid: bool = False
    finite: bool = False

    def __get_pydantic_core_schema__(self, source: Any, handler: Callable[[Any], CoreSchema]) -> CoreSchema:
        """Return how pydantic reads and writes the array."""
        writer = core_schema.plain_serializer_function_ser_schema(
            lambda array: json_tree("an array", np.asarray(array)), when_used="json"
        )
        return core_schema.no_info_plain_validator_function(self._read, serialization=writer)

    def _read(self, value: Any) -> Float:
        numbers = _nested_numbers(value)
        try:
            array = np.array(numbers, dtype=np.float64)
        except ValueError as problem:  # rows of different lengths
            raise self._wrong("rows of different lengths") from problem
        if array.shape != self.shape:
            raise self._wrong(" x ".join(map(str, array.shape)) or "a single number")
        if self.finite and not np.isfinite(array).all():
            raise self._wrong("values that are not finite")
        if self.rigid:
            try:
                se3.check_rigid("the transform", array, tolerance=1e-9)
            except InputError as problem:
                raise PydanticCustomError("rigid", "a rigid transform: {what}", {"what": problem.what}) from problem
        array.flags.writeable = False
        return array

    def _wrong(self, got: str) -> PydanticCustomError:
        shape = " x ".join(map(str, self.shape))
        return PydanticCustomError("shape", "{shape} numbers, not {got}", {"shape": shape, "got": got})


def _nested_numbers(value: Any) -> Any:
    return [_nested_numbers(entry) for entry in value] if isinstance(value, list | tuple) else _number(value)


Pose = Annotated[Float, JsonArray((4, 4), rigid=True)]
"""A rigid transform (4, 4)."""
Covariance = Annotated[Float, JsonArray((6, 6))]
"""A covariance (6, 6) of rotation (rad) and translation (m)."""


@dataclass(frozen=True)
class Derived:
    """Annotate a dataclass field: write these properties of its value, too; they are ignored when the value is read."""

    names: tuple[str, ...]

    def __get_pydantic_core_schema__(self, source: Any, handler: Callable[[Any], CoreSchema]) -> CoreSchema:
        """Return the schema of the dataclass with the properties added."""
        return core_schema.no_info_before_validator_function(
            self._without,
            handler(source),
            serialization=core_schema.wrap_serializer_function_ser_schema(self._with, when_used="json"),
        )

    def _without(self, value: Any) -> Any:
        return {k: v for k, v in value.items() if k not in self.names} if isinstance(value, Mapping) else value

    def _with(self, value: Any, write: Callable[[Any], Any]) -> Any:
        return {name: json_tree(name, getattr(value, name)) for name in self.names} | write(value)


class Schema:
    """Values of one type as JSON and back: pydantic's TypeAdapter, unknown keys refused, errors of one line."""

    def __init__(self, kind: Any) -> None:
        self._kind = kind

    @cached_property
    def _adapter(self) -> TypeAdapter[tuple[Any]]:
        # A dataclass of the standard library takes the configuration of the type that holds it.
        holder: Any = tuple
        return TypeAdapter(holder[self._kind], config=ConfigDict(extra="forbid"))

    def plain(self, value: Any) -> Any:
        """Return a value as dicts, lists, numbers, texts and None; raises InputError for what JSON cannot represent."""
        try:
            return self._adapter.dump_python((value,), mode="json", warnings=False)[0]
        except PydanticSerializationError as problem:
            raise InputError("a value has no form in JSON", got=problem) from problem

    def read(self, value: Any, name: str = "") -> Any:
        """Return the value of parsed JSON; `name` is what errors call the whole.

        Raises InputError for the first missing or unknown key and the first value of another type, named by its path.
        """
        try:
            return self._adapter.validate_python((value,))[0]
        except ValidationError as problem:
            first = problem.errors(include_url=False)[0]
            path = ".".join(str(part) for part in first["loc"][1:]) or name
            words = {"missing": "is missing", "unexpected_keyword_argument": "is unknown"}
            if first["type"] in words:
                raise InputError(f"{path} {words[first['type']]}") from problem
            expected = first["msg"].removeprefix("Value error, ").removeprefix("Input should be ")
            raise InputError(f"{path} is not valid", expected=expected, got=repr(first["input"])[:60]) from problem
