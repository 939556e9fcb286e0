"""The page: tables, learning curves, rollouts and all scenes in one self-contained file."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from magical.evaluation.variants import short_variant
from magical.files import write_atomically
from magical.report.clips import SIZE, Clip, data_uri, png
from magical.report.tables import DARKEST, LIGHTEST, Table


@dataclass(frozen=True, slots=True)
class Page:
    """The contents of a page; empty parts are left out."""

    title: str
    subtitle: str
    tables: Sequence[Table]
    rollouts: int  # on each variant
    aggregate: Sequence[Sequence[str]] = ()  # a header and a row for each method
    aggregate_note: str = ""
    curves: str = ""  # SVG
    reels: Mapping[str, Sequence[Clip]] = field(default_factory=dict)  # rollouts by title
    sheet: NDArray[Any] | None = None  # (H, W, 3) uint8
    facts: Mapping[str, str] = field(default_factory=dict)  # how it was made, by name

    def html(self) -> str:
        """The page's source, with everything inline: nothing is loaded from elsewhere."""
        import jinja2  # from the report extra

        environment = jinja2.Environment(
            loader=jinja2.PackageLoader("magical.report"),
            autoescape=True,
            undefined=jinja2.StrictUndefined,
            trim_blocks=True,
            lstrip_blocks=True,
        )
        return environment.get_template("page.html.j2").render(
            title=self.title,
            subtitle=self.subtitle,
            tables=self.tables,
            rollouts=self.rollouts,
            lightest=f"rgb{LIGHTEST}",
            darkest=f"rgb{DARKEST}",
            aggregate=self.aggregate,
            aggregate_note=self.aggregate_note,
            curves=self.curves,
            reels=[_reel(title, clips) for title, clips in self.reels.items()],
            clip_size=SIZE,
            sheet=None if self.sheet is None else data_uri(png(self.sheet), "image/png"),
            facts=self.facts,
        )

    def write(self, path: Path | str) -> None:
        """Write the page; raises `OSError` where that is not possible."""
        text = self.html()
        with write_atomically(path) as file:
            file.write(text.encode())


def _reel(title: str, clips: Sequence[Clip]) -> dict[str, Any]:
    shown = [
        {
            "variant": short_variant(clip.env_id.variant),
            "score": clip.score,
            "uri": data_uri(clip.webp(), "image/webp"),
        }
        for clip in clips
    ]
    return {"title": title, "clips": shown}
