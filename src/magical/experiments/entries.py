"""What entries record about policies and how they were made; loading the policies of entries."""

import os
from contextlib import AbstractContextManager, nullcontext
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from magical.errors import PolicyError
from magical.evaluation import BUILT_IN, Entry, Policy, load_policy, policy_names
from magical.evaluation.entry import DATE, POLICY, THREADS
from magical.messages import quoted
from magical.runs import is_run
from magical.runs.machine import provenance
from magical.runs.sources import LEARNED_FROM

MAX_THREADS = 1024  # the most that an entry can ask for


def evaluation_details(policy: str, out: Path) -> dict[str, Any]:
    """What an entry written to `out` records about the policy and about this evaluation.

    Args:
        policy: a run folder, which is recorded relative to `out`, or another policy's name.
        out: the entry's folder.
    """
    made = {DATE: f"{datetime.now(UTC):%FT%TZ}", **provenance()}
    if policy in BUILT_IN:
        return {POLICY: policy, LEARNED_FROM: [], **made}
    if policy in policy_names() or not Path(policy).is_dir():
        return {POLICY: policy, **made}
    from magical.learning import read_config
    from magical.learning.running.devices import num_threads

    details = {**read_config(Path(policy)).training_details, THREADS: num_threads()}
    relative = os.path.relpath(Path(policy).resolve(), out.resolve())  # `..` of a link is elsewhere
    return {POLICY: relative, **details, **made}


def policy_of(folder: Path, entry: Entry, run: Path | None = None) -> Policy:
    """The policy of an evaluated run: from its run folder, or by a name in `policy_names`.

    Other code that an entry names is not run, since entries may come from anywhere.

    Args:
        folder: the entry's folder.
        entry: the entry.
        run: the run folder if the entry names none; by default `folder`.

    Raises:
        PolicyError: the entry has no such policy.
        RunFolderError, CheckpointError: the run cannot be loaded.
    """
    name = entry.details.get(POLICY)
    if isinstance(name, str) and name in policy_names():
        return load_policy(name)
    recorded = [folder / name] if isinstance(name, str) else []
    for place in (*recorded, run or folder):
        if is_run(place):
            return load_policy(place)
    raise PolicyError(
        f"{folder}: expected a run folder or one of {', '.join(policy_names())} as the policy "
        f"that was evaluated, found {quoted(name)}; magical verify takes others by --policy"
    )


def recorded_threads(entry: Entry) -> AbstractContextManager[None]:
    """A context in which PyTorch uses as many CPU threads as in an entry's evaluation.

    Another number may change the last bit of a network's arithmetic. If the entry records no
    number, nothing changes, and PyTorch is not imported.
    """
    number = entry.details.get(THREADS)
    if not isinstance(number, int) or not 1 <= number <= MAX_THREADS:
        return nullcontext()
    from magical.learning.running.devices import cpu_threads

    return cpu_threads(number)
