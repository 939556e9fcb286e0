"""Programs as text, and how probable they are before any demonstration.

A program is written by choosing an expression for each slot, and the words within it. Every choice
is uniform, so a program of b bits has probability 2**-b: the shorter, the more probable.
"""

import ast
import math
from collections.abc import Iterator, Mapping
from enum import StrEnum
from itertools import product
from typing import TypeVar

from magical.errors import InvalidProgramError
from magical.messages import quoted
from magical_goals.language import expressions, goals
from magical_goals.language.expressions import Expression, Place, Selection, field_types
from magical_goals.language.goals import Goal

Kind = TypeVar("Kind", bound=Expression)

MAX_TEXT = 5000  # characters
KINDS: tuple[type[Expression], ...] = (Selection, Place, Goal)
VOCABULARY: Mapping[str, type[Expression]] = {
    name: kind
    for module in (expressions, goals)
    for name, kind in vars(module).items()
    if isinstance(kind, type)
    and issubclass(kind, KINDS)
    and kind not in KINDS
    and not name.startswith("_")
}  # every kind of expression by its name


def parse(text: str) -> Goal:
    """Parse a program such as `Each(WithColour('red'), InRegion())`, without evaluating anything.

    Raises:
        InvalidProgramError: the text is not a program; the message says what is wrong where.
    """
    if len(text) > MAX_TEXT:
        raise InvalidProgramError(f"program: expected at most {MAX_TEXT} characters, found more")
    try:
        tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, MemoryError, RecursionError) as error:
        raise InvalidProgramError(
            f"program {quoted(text)}: expected an expression such as "
            "Each(WithColour('red'), InRegion())"
        ) from error
    try:
        program = _expression(tree)
    except RecursionError as error:
        raise InvalidProgramError(f"program {quoted(text)}: nested too deeply") from error
    if not isinstance(program, Goal):
        raise InvalidProgramError(
            f"program {quoted(text)}: expected a goal, found a {type(program).__name__}"
        )
    return program


def _expression(node: ast.expr) -> Expression | str:
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    text = ast.unparse(node)
    if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Name) or node.keywords:
        raise InvalidProgramError(
            f"expression {quoted(text)}: expected a name with its arguments, or a word in quotes"
        )
    if (kind := VOCABULARY.get(node.func.id)) is None:
        raise InvalidProgramError(
            f"expression {quoted(text)}: {node.func.id} is unknown; expected one of: "
            f"{', '.join(sorted(VOCABULARY))}"
        )
    values = [_expression(argument) for argument in node.args]
    try:
        return kind(*values)
    except TypeError as error:  # too few or too many arguments
        raise InvalidProgramError(f"expression {quoted(text)}: {error}") from error


def bits_of_part(part: Expression) -> float:
    """Bits of an expression and its words, without the expressions within it."""
    kinds = field_types(type(part)).values()
    return choice(type(part)) + sum(math.log2(len(k)) for k in kinds if issubclass(k, StrEnum))


def choice(kind: type[Expression]) -> float:
    """The bits of the choice of a kind of selection, place or goal."""
    base = next(base for base in KINDS if issubclass(kind, base))
    return math.log2(sum(issubclass(other, base) for other in VOCABULARY.values()))


def simple_expressions(base: type[Kind]) -> Iterator[Kind]:
    """All expressions of a kind whose fields, if any, are all words."""
    for kind in VOCABULARY.values():
        words = field_types(kind).values()
        if issubclass(kind, base) and all(issubclass(word, StrEnum) for word in words):
            yield from (kind(*values) for values in product(*words))
