"""The gallery's page and its folder."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from magical import __version__
from magical.errors import SiteError
from magical.files import is_partial, write_atomically
from magical.report.gallery.descriptions import (
    Description,
    axis_name,
    describe_changes,
    describe_task,
)
from magical.report.gallery.previews import IMAGE_FOLDERS, SIZE, SPEED, EnvPreview
from magical.report.pages.page import render_template
from magical.scene.constants import CONTROL_RATE
from magical.tasks import CHANGES, VARIANTS, Task, get_task
from magical.tasks.axes import short_variant

INDEX = "index.html"
GENERATOR = f"magical gallery {__version__}"
_MARK = b'<meta name="generator" content="magical gallery'


@dataclass(frozen=True, slots=True)
class TaskSection:
    """One task with its environments."""

    task: Task
    description: Description
    previews: Mapping[str, EnvPreview]  # by variant

    @property
    def seconds(self) -> float:
        """An episode's duration at the control rate."""
        return self.task.horizon / CONTROL_RATE

    def changes(self, variant: str) -> str:
        """What the variant changes, in words."""
        return describe_changes(self.task, variant)


@dataclass(frozen=True, slots=True)
class Gallery:
    """The environments to show, and the seed of their scenes."""

    previews: Sequence[EnvPreview]
    seed: int = 0

    def write(self, site: Path | str) -> int:
        """Write the page, after the images that it shows; returns the size of all in bytes.

        A gallery that is there is replaced; images of environments that only it shows stay.

        Raises:
            SiteError: the folder holds something other than a gallery.
            OSError: the folder cannot be written to.
        """
        folder = Path(site)
        check_site(folder)
        files = {**self._images(), INDEX: self.html().encode()}
        for name, data in files.items():
            with write_atomically(folder / name) as file:
                file.write(data)
        return sum(map(len, files.values()))

    def html(self) -> str:
        """The page's source; images are in files beside it, nothing is loaded from elsewhere."""
        return render_template(
            "gallery.html.j2",
            generator=GENERATOR,
            sections=list(self._sections()),
            variants=VARIANTS,
            short_variant=short_variant,
            changes={axis_name(axis): text for axis, text in CHANGES.items()},
            count=len(self.previews),
            seed=self.seed,
            size=SIZE,
            speed=SPEED,
            rate=CONTROL_RATE,
        )

    def _sections(self) -> Iterator[TaskSection]:
        by_task: dict[str, dict[str, EnvPreview]] = {}
        for preview in self.previews:
            by_task.setdefault(preview.env_id.task, {})[preview.env_id.variant] = preview
        for name, previews in by_task.items():
            task = get_task(name)
            yield TaskSection(task, describe_task(task), previews)

    def _images(self) -> dict[str, bytes]:
        """Every image by its address on the page."""
        stills = {preview.still_path: preview.still for preview in self.previews}
        rollouts = {p.animation_path: p.animation for p in self.previews if p.animation}
        return stills | rollouts


def check_site(site: Path | str) -> None:
    """Check that a gallery may be written to a folder: it is missing, empty or holds a gallery.

    Raises:
        SiteError: it holds something else; the message names it.
    """
    folder = Path(site)
    if folder.exists() and not folder.is_dir():
        raise SiteError(f"{folder}: expected a folder, found a file; choose another")
    for path in sorted(folder.iterdir()) if folder.is_dir() else ():
        if not _is_ours(path):
            raise SiteError(
                f"{folder}: expected an empty folder or a gallery, found {path.name}; "
                "choose another folder"
            )


def _is_ours(path: Path) -> bool:
    """Whether a file or folder is one that a gallery has."""
    if path.name in IMAGE_FOLDERS:
        return path.is_dir() and all(file.suffix in (".webp", ".part") for file in path.iterdir())
    if path.name == INDEX:
        return path.is_file() and _MARK in path.read_bytes()
    return is_partial(path, INDEX)
