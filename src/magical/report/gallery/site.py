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
    """Write the images and then the page; returns their total size in bytes.

    An existing gallery is replaced, but images of environments that it no longer shows remain.

    Args:
        folder: the site's folder.
        previews: previews of the environments to show.
        seed: the seed of their scenes, shown on the page.

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
    """The page's HTML; images are in separate files, and nothing is loaded from other hosts."""
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
    """Check that a folder may be written to: it is missing, empty or holds a gallery.

    Raises:
        SiteError: the folder holds something else, which the message names, or it is a file.
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
    """Whether a file or folder belongs to a gallery."""
    if path.name in IMAGE_FOLDERS:
        return path.is_dir() and all(file.suffix in (".webp", ".part") for file in path.iterdir())
    if path.name == INDEX:
        return path.is_file() and _MARK in path.read_bytes()
    return is_partial(path, INDEX)
