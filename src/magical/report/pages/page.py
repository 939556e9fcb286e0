"""Code shared by the pages: figures, templates, writing files."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from magical.files import write_atomically


@dataclass(frozen=True, slots=True)
class Figure:
    """A plot with a caption."""

    svg: str
    caption: str


def render_template(name: str, **values: Any) -> str:
    """Render one of this package's templates; values are escaped."""
    import jinja2  # from the `report` extra

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("magical.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(name).render(**values)


def write_text(path: Path | str, text: str) -> None:
    """Write a text file atomically, in UTF-8; raises `OSError` if it cannot be written.

    Characters that UTF-8 cannot encode, such as undecodable bytes in file names, are escaped.
    """
    with write_atomically(path) as file:
        file.write(text.encode(errors="backslashreplace"))
