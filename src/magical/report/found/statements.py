"""What entries state in their details in addition to their sources (docs/protocol.md)."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from magical.evaluation import Entry
from magical.evaluation.entry import UPDATES
from magical.messages import quoted
from magical.runs.sources import learned_from, learning_class

LOOKS = "looks"
MARKS = (
    " After a method's name, † says that test variants were evaluated while it was designed, and "
    "the letter in brackets is its class (docs/protocol.md)."
)


class Statements(NamedTuple):
    """What the entries of one method state together.

    Attributes:
        demonstrations: how many and whose; empty if no entry says.
        looks: how often test variants were evaluated before: the largest number that an entry
            states; None if none does.
    """

    demonstrations: str = ""
    looks: int | None = None

    @property
    def mark(self) -> str:
        """A dagger if test variants were evaluated before, otherwise empty."""
        return "†" if self.looks else ""


UNSTATED = Statements()


def gather_statements(details: Iterable[Mapping[str, Any]]) -> Statements:
    """The statements of a method's entries, from their details.

    Raises `ValueError` as `stated_looks` does.
    """
    entries = list(details)
    demonstrations = [str(e["demonstrations"]) for e in entries if "demonstrations" in e]
    looks = [found for entry in entries if (found := stated_looks(entry)) is not None]
    return Statements("; ".join(dict.fromkeys(demonstrations)), max(looks, default=None))


def marks(looks: object, row_class: str) -> str:
    """What follows a method's name in tables: † for looks above 0, then its class in brackets."""
    return f"{'†' if looks else ''}{f' [{row_class}]' if row_class else ''}"


def marked(label: str, runs: Sequence[Entry]) -> str:
    """A row's label: `with_conditions`, then its `marks`."""
    looks = any(entry.details.get(LOOKS) for entry in runs)
    return with_conditions(label, runs) + marks(looks, class_of(runs))


def with_conditions(label: str, runs: Iterable[Entry]) -> str:
    """A row's label that says in parentheses if its runs see the state, or are unfinished."""
    entries = list(runs)
    found = ["sees the state"] if any(entry.privileged for entry in entries) else []
    if parts := list(dict.fromkeys(filter(None, (unfinished(e.details) for e in entries)))):
        found.append(f"unfinished: {', '.join(parts)}")
    return f"{label} ({'; '.join(found)})" if found else label


def class_of(runs: Sequence[Entry]) -> str:
    """The class of a row's entries together; empty if one does not state what it learned from."""
    try:
        used = {name for entry in runs for name in learned_from(entry.details)}
    except ValueError:
        return ""
    return "" if any(entry.privileged for entry in runs) else learning_class(used)


def stated_looks(details: Mapping[str, Any]) -> int | None:
    """How often test variants were evaluated before, according to an entry; None if not stated.

    Raises:
        ValueError: the entry states something other than a whole number, 0 or more.
    """
    looks = details.get(LOOKS)
    if looks is None or (type(looks) is int and looks >= 0):
        return looks
    raise ValueError(
        f"expected {LOOKS} in the details to be a whole number, 0 or more; found {quoted(looks)}"
    )


def unfinished(details: Mapping[str, Any]) -> str:
    """How far a training run was, such as `25 of 600 updates`; empty if finished or not stated."""
    match details.get(UPDATES):
        case {"done": int(done), "planned": int(planned)} if done < planned:
            return f"{done} of {planned} updates"
    return ""
