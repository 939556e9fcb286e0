"""The gallery's page and its folder."""

from collections.abc import Sequence
from operator import attrgetter
from pathlib import Path

from magical import __version__
from magical.errors import SiteError
from magical.files import is_partial, write_atomically
from magical.grouping import group_by
from magical.report.gallery.descriptions import axis_name, describe_changes, describe_task
from magical.report.gallery.previews import IMAGE_FOLDERS, SIZE, SPEED, EnvPreview
from magical.report.pages.page import render_template
from magical.scene.constants import CONTROL_RATE
from magical.tasks import CHANGES, VARIANTS
from magical.tasks.axes import short_variant

INDEX = "index.html"
GENERATOR = f"magical gallery {__version__}"
_MARK = b'<meta name="generator" content="magical gallery'


def write_gallery(folder: Path, previews: Sequence[EnvPreview], seed: int = 0) -> int:
    """Write the page, after the images that it shows; returns the size of all in bytes.

    A gallery that is there is replaced; images of environments that only it shows stay.

    Args:
        folder: the site's.
        previews: of the environments to show.
        seed: of their scenes.

    Raises:
        SiteError: the folder holds something other than a gallery.
        OSError: the folder cannot be written to.
    """
    check_site(folder)
    files = {preview.still_path: preview.still for preview in previews}
    files |= {p.animation_path: p.animation for p in previews if p.animation}
    files[INDEX] = gallery_page(previews, seed).encode()
    for name, data in files.items():
        with write_atomically(folder / name) as file:
            file.write(data)
    return sum(map(len, files.values()))


def gallery_page(previews: Sequence[EnvPreview], seed: int = 0) -> str:
    """The page's source; images are in files beside it, nothing is loaded from elsewhere."""
    tasks = group_by(previews, attrgetter("env_id.task_spec"))
    return render_template(
        "gallery.html.j2",
        generator=GENERATOR,
        sections=[(task, describe_task(task), previews) for task, previews in tasks.items()],
        variants=VARIANTS,
        short_variant=short_variant,
        describe_changes=describe_changes,
        changes={axis_name(axis): text for axis, text in CHANGES.items()},
        count=len(previews),
        seed=seed,
        size=SIZE,
        speed=SPEED,
        rate=CONTROL_RATE,
    )


def check_site(folder: Path) -> None:
    """Check that a gallery may be written to a folder: it is missing, empty or holds a gallery.

    Raises:
        SiteError: it holds something else; the message names it.
    """
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
