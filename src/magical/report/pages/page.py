"""What the pages have in common: figures, templates, writing."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from magical.files import write_atomically


@dataclass(frozen=True, slots=True)
class Figure:
    """A plot with what it says."""

    svg: str
    caption: str


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
