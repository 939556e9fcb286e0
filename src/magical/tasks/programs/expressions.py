"""What all expressions of the goal language have in common: types, text, parts.

An expression is a frozen dataclass. Its fields are expressions, or words such as a colour, checked
when it is created. Its `repr` is its text, which `magical.tasks.programs.parse` reads.
"""

from collections.abc import Iterator, Mapping
from dataclasses import fields
from enum import StrEnum
from typing import Any

from magical.errors import InvalidProgramError, UnknownNameError
from magical.messages import quoted
from magical.scene.vocabulary import parse_word


class Attribute(StrEnum):
    """What blocks may have in common."""

    COLOUR = "colour"
    SHAPE = "shape"
    KIND = "kind"  # colour and shape

    @property
    def words(self) -> str:
        """The attribute in English."""
        return "colour and shape" if self is Attribute.KIND else str(self)


class Expression:
    """A typed expression; the types of its fields are classes.

    Raises:
        InvalidProgramError: a field has a wrong type; the message names the expression and field.
    """

    def __post_init__(self) -> None:
        for name, kind in field_types(type(self)).items():
            value = getattr(self, name)
            if issubclass(kind, StrEnum):
                try:
                    object.__setattr__(self, name, parse_word(kind, value))
                except UnknownNameError as error:
                    raise InvalidProgramError(f"{type(self).__name__}, {name}: {error}") from error
            elif not isinstance(value, kind):
                raise InvalidProgramError(
                    f"{type(self).__name__}, {name}: expected a {kind.__name__.lower()}, found "
                    f"{quoted(value)}"
                )

    @property
    def values(self) -> list[Any]:
        """The values of its fields, in order."""
        return [getattr(self, name) for name in field_types(type(self))]

    def __repr__(self) -> str:
        texts = (repr(str(v)) if isinstance(v, StrEnum) else repr(v) for v in self.values)
        return f"{type(self).__name__}({', '.join(texts)})"

    @property
    def parts(self) -> Iterator["Expression"]:
        """The expression itself and all expressions within it."""
        yield self
        for value in self.values:
            if isinstance(value, Expression):
                yield from value.parts


def field_types(kind: Any) -> Mapping[str, Any]:
    """The fields of a class of expressions, with their types."""
    return {field.name: field.type for field in fields(kind)}
