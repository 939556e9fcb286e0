"""Datasets of demonstrations on the Hugging Face Hub, with a card generated from their provenance.

Needs the `hub` extra. Endpoint and token are those of `huggingface_hub`: from HF_ENDPOINT and
HF_TOKEN, or from `hf auth login`.
"""

import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from magical import __version__
from magical.demos.store.dataset import Dataset
from magical.demos.store.manifest import FOLDER, NAME, new_text
from magical.demos.store.summary import DatasetSummary, summarise_dataset
from magical.errors import DatasetError
from magical.extras import require
from magical.messages import printable, quoted

CARD = "README.md"
_FILES = (NAME, f"{FOLDER}/*.npz")  # a dataset's files in a repository


def push(dataset: Dataset, repo: str, licence: str, *, private: bool = False) -> str:
    """Upload a dataset in one commit, with its card; returns the repository's address.

    The repository is created if it does not exist. Trajectories of an earlier dataset in it are
    removed; other files stay.

    Args:
        dataset: the dataset, all of which is read first.
        repo: `OWNER/NAME`.
        licence: a licence identifier of the Hub, such as `cc-by-4.0`.
        private: whether a new repository is private.

    Raises:
        DatasetError: the dataset contains published human demonstrations, or is empty; a trajectory
            is damaged; the Hub refuses the upload or cannot be reached.
        MissingDependencyError: `huggingface_hub` is not installed.
    """
    require("hub")
    from huggingface_hub import CommitOperationAdd, CommitOperationDelete, HfApi

    _require_publishable(dataset)
    files: dict[str, bytes | Path] = {CARD: card(dataset, repo, licence).encode()}
    files[NAME] = new_text(list(dataset.entries)).encode()  # `dataset` may be a subset
    for entry in dataset.entries:
        files[entry.file] = dataset.path / entry.file
    with _hub_errors(repo):
        api = HfApi(library_name="magical-benchmark", library_version=__version__)
        made = api.create_repo(repo, repo_type="dataset", private=private, exist_ok=True)
        before = api.list_repo_files(repo, repo_type="dataset")
        own = {path for path in before if any(fnmatchcase(path, kind) for kind in _FILES)}
        api.create_commit(
            repo,
            [
                *(CommitOperationAdd(path, content) for path, content in files.items()),
                *map(CommitOperationDelete, sorted(own - files.keys())),
            ],
            commit_message=f"{len(dataset)} demonstrations, by magical {__version__}",
            repo_type="dataset",
        )
    return str(made)


def pull(repo: str, out: Path | str, revision: str | None = None) -> Dataset:
    """Download a dataset completely and verify every checksum; on failure nothing remains.

    Args:
        repo: `OWNER/NAME`.
        out: a new folder.
        revision: a branch, tag or commit (default: the main branch).

    Raises:
        DatasetError: the folder exists; there is no such dataset, or it is damaged; the Hub cannot
            be reached.
        MissingDependencyError: `huggingface_hub` is not installed.
    """
    require("hub")
    from huggingface_hub import snapshot_download

    out = Path(out)
    if out.exists():
        raise DatasetError(f"{out}: expected a new folder, found one that exists; choose another")
    out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=out.parent, prefix=".pull-") as temporary:
        folder = Path(temporary) / "dataset"
        with _hub_errors(repo):
            snapshot_download(
                repo,
                repo_type="dataset",
                revision=revision,
                local_dir=folder,
                cache_dir=Path(temporary) / "cache",
                allow_patterns=list(_FILES),
                library_name="magical-benchmark",
                library_version=__version__,
            )
        dataset = Dataset.open(folder)
        for entry in dataset.entries:
            dataset.read(entry)
        shutil.rmtree(folder / ".cache", ignore_errors=True)  # the Hub client's cache
        folder.rename(out)
    return Dataset(out, dataset.entries)


def _require_publishable(dataset: Dataset) -> None:
    """Refuse the published human demonstrations, which `magical demos import` marks."""
    if not dataset.entries:
        raise DatasetError(f"{dataset.path}: expected demonstrations, found none")
    published = [entry for entry in dataset.entries if entry.source_sha256]
    if published:
        raise DatasetError(
            f"{dataset.path}: {len(published)} of {len(dataset)} demonstrations are from published "
            f"files, such as {quoted(published[0].source or published[0].file)}; they carry no "
            "licence, so they may not be republished; others can get them with "
            "`magical demos download`"
        )


def card(dataset: Dataset, repo: str, licence: str) -> str:
    """The dataset card: the contents, and how, when and with what they were recorded."""
    summaries = summarise_dataset(dataset)
    facts = "\n".join(f"- {name}: {value}" for name, value in _provenance(dataset).items())
    names = ("environment", "demonstrations", "steps", "mean score", "labels", "by")
    rows = [names, ("---",) * len(names), *map(_row, summaries)]
    table = "\n".join(f"| {' | '.join(map(str, row))} |" for row in rows)
    return f"""---
license: {licence}
task_categories: [robotics, reinforcement-learning]
tags: [magical-benchmark, imitation-learning]
pretty_name: MAGICAL demonstrations
---

# Demonstrations for the MAGICAL benchmark

{table}

Labels: demonstrations with actions to imitate in addition to those that were executed.

## Provenance

{facts}

## Use

```bash
pip install "magical-benchmark[hub]"
magical demos pull {repo} --out demos
```

The files are a dataset of the package `magical-benchmark`: `manifest.jsonl` has a line with
checksums for each trajectory.
"""


def _row(summary: DatasetSummary) -> tuple[object, ...]:
    score = "-" if summary.score is None else f"{summary.score:.3f}"
    by = printable(", ".join(summary.demonstrators)).replace("|", "/")
    steps = f"{summary.lengths[0]}-{summary.lengths[2]}"
    return summary.env_id, summary.count, steps, score, summary.with_expert_actions, by


def _provenance(dataset: Dataset) -> dict[str, str]:
    """Facts about the recording from the trajectories' metadata, leaving out unknown ones."""
    records = [dict(trajectory.metadata) for trajectory in dataset]
    dates = sorted(str(record["recorded"])[:10] for record in records if "recorded" in record)
    versions = [v for record in records if isinstance(v := record.get("versions"), dict)]
    found = {
        "Recorded": " to ".join(dict.fromkeys((dates[0], dates[-1]))) if dates else "",
        **{
            f"Version of {n}": _values(versions, n)
            for n in sorted({n for v in versions for n in v})
        },
        "Platform": _values(records, "platform"),
        "Share of random actions": _values(records, "perturb"),
    }
    return {name: value for name, value in found.items() if value}


def _values(records: Iterable[dict[str, Any]], name: str) -> str:
    return printable(", ".join(sorted({str(r[name]) for r in records if name in r})))


@contextmanager
def _hub_errors(repo: str) -> Iterator[None]:
    """Turn Hub and connection errors into a `DatasetError` that names the repository."""
    from huggingface_hub.errors import (  # type: ignore[attr-defined]  # HTTPError is httpx's
        HfHubHTTPError,
        HFValidationError,
        HTTPError,
        LocalTokenNotFoundError,
    )

    try:
        yield
    except (LocalTokenNotFoundError, HfHubHTTPError) as error:
        status = getattr(getattr(error, "response", None), "status_code", None)
        login = "; log in with `hf auth login`" if status in (None, 401, 403) else ""
        first = str(error).strip().partition("\n")[0]
        raise DatasetError(f"{quoted(repo)} on the Hub: {printable(first)}{login}") from error
    except HFValidationError as error:
        raise DatasetError(f"repository: expected OWNER/NAME, found {quoted(repo)}") from error
    except (HTTPError, OSError, RuntimeError, ValueError) as error:
        raise DatasetError(f"{quoted(repo)} on the Hub: {printable(str(error))}") from error
