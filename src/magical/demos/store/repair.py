"""Finding what is wrong with a dataset, and saving what is not."""

from pathlib import Path

from magical.demos.store import manifest
from magical.demos.store.codec import decode
from magical.demos.store.dataset import Dataset, Problem, read_file, read_manifest
from magical.demos.store.lock import locked
from magical.demos.store.manifest import ManifestEntry
from magical.errors import DatasetError
from magical.files import write_atomically


def check(path: Path | str) -> list[Problem]:
    """Everything wrong with a dataset; reads every file."""
    return list(Dataset.open(path, skip_damaged=True).problems)


def repair(path: Path | str) -> list[Problem]:
    """Write the manifest anew from the intact files; returns what was wrong.

    Damaged trajectory files are moved to the folder `damaged`. Raises `DatasetError` where there is
    no dataset, `OSError` where it cannot be written.
    """
    folder = Path(path)
    if not (folder / manifest.FOLDER).is_dir():
        raise DatasetError(f"{folder}: expected a dataset, found no {manifest.FOLDER} in it")
    with locked(folder / manifest.LOCK):
        try:
            entries, problems = read_manifest(folder)
        except DatasetError as error:
            entries, problems = [], [Problem(str(folder / manifest.NAME), str(error))]
        sums = {entry.file: entry.sha256 for entry in entries}
        kept = []
        for file in sorted((folder / manifest.FOLDER).glob("*.npz")):
            try:
                kept.append(_recovered(folder, file, sums))
            except DatasetError as error:
                problems.append(Problem(str(file), str(error)))
                (folder / "damaged").mkdir(exist_ok=True)
                file.rename(folder / "damaged" / file.name)
        with write_atomically(folder / manifest.NAME) as out:
            out.write(manifest.new_text(kept).encode())
    return problems


def _recovered(folder: Path, file: Path, sums: dict[str, str]) -> ManifestEntry:
    raw = read_file(file)
    number = file.name.split("-")[0]
    entry = ManifestEntry.of(decode(raw), raw, int(number) if number.isdecimal() else -1)
    if folder / entry.file != file:
        raise DatasetError(f"{file}: expected the name {entry.file}")
    if sums.get(entry.file, entry.sha256) != entry.sha256:
        raise DatasetError(f"{file}: was changed after it was written")
    return entry
