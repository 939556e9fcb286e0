"""The page: tables, learning curves and rollouts in one self-contained file."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from magical.files import write_atomically
from magical.report.figures.reels import Reel
from magical.report.found.facts import MethodFacts
from magical.report.scores.grids import Grid
from magical.report.scores.tables import DARKEST, LIGHTEST, Table


@dataclass(frozen=True, slots=True)
class Figure:
    """A plot with what it says."""

    svg: str
    caption: str


@dataclass(frozen=True, slots=True)
class Page:
    """The contents of a page; empty parts are left out."""

    title: str
    subtitle: str
    tables: Sequence[Table]
    rollouts: int | str  # on each variant, "3 to 100" where they differ
    aggregate: Grid | None = None  # a row for each method
    aggregate_figures: Sequence[Figure] = ()
    gaps: Grid | None = None
    improvement: Table | None = None
    curves: Mapping[str, Sequence[str]] = field(default_factory=dict)  # SVG, by task
    extremes: Sequence[Reel] = ()  # the best, median and worst rollouts of runs
    clip_notes: Sequence[str] = ()  # which runs' rollouts are not shown, and why
    missing: Grid | None = None  # which scores are missing
    skipped: Grid | None = None  # which files could not be used
    methods: Sequence[MethodFacts] = ()  # how each run was made
    facts: Mapping[str, str] = field(default_factory=dict)  # how it was made, by name

    def html(self) -> str:
        """The page's source, with everything inline: nothing is loaded from elsewhere."""
        return render_template(
            "page.html.j2",
            page=self,
            lightest=f"rgb{LIGHTEST}",
            darkest=f"rgb{DARKEST}",
        )

    def write(self, path: Path | str) -> None:
        """Write the page; raises `OSError` where that is not possible."""
        write_text(path, self.html())


def render_template(name: str, **values: Any) -> str:
    """One of the templates of this package with values, which are escaped."""
    import jinja2  # from the report extra

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("magical.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(name).render(**values)


def write_text(path: Path | str, text: str) -> None:
    """Write a text file atomically, in UTF-8; raises `OSError` where that is not possible.

    What UTF-8 cannot encode, such as bytes of a file's name that are no text, is escaped.
    """
    with write_atomically(path) as file:
        file.write(text.encode(errors="backslashreplace"))
