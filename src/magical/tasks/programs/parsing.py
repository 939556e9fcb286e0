"""Parsing of programs: the text that `repr` prints is read back without evaluating anything."""

import ast
from collections.abc import Mapping

from magical.errors import InvalidProgramError
from magical.messages import quoted
from magical.tasks.programs import goals, places, selections
from magical.tasks.programs.expressions import Expression
from magical.tasks.programs.goals import Goal

MAX_TEXT = 5000  # characters

KINDS: tuple[type[Expression], ...] = (selections.Selection, places.Place, Goal)
VOCABULARY: Mapping[str, type[Expression]] = {
    name: kind
    for module in (selections, places, goals)
    for name, kind in vars(module).items()
    if isinstance(kind, type)
    and issubclass(kind, KINDS)
    and kind not in KINDS
    and not name.startswith("_")
}  # every kind of expression by its name


def parse(text: str) -> Goal:
    """Parse a program such as `Each(WithColour('red'), InRegion())`.

    Raises:
        InvalidProgramError: the text is not a program; the message names the expression and the
            reason.
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
