"""What entries record about policies and how they were made; loading the policies of entries."""

import os
from contextlib import AbstractContextManager, nullcontext
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from magical.errors import PolicyError
from magical.evaluation.entry import DATE, LEARNED_FROM, POLICY, THREADS, Entry
from magical.evaluation.loading import BUILT_IN, load_policy, policy_names
from magical.evaluation.policy import Policy
from magical.messages import quoted
from magical.runs import is_run
from magical.runs.machine import provenance

MAX_THREADS = 1024  # the most that an entry can ask for


def evaluation_details(policy: Policy, name: str, out: Path) -> dict[str, Any]:
    """What an entry written to `out` records about the policy and about this evaluation.

    Args:
        policy: the policy, whose `record` is included if it has one.
        name: a run folder, which is recorded relative to `out`, or another policy's name.
        out: the entry's folder.
    """
    made = {DATE: f"{datetime.now(UTC):%FT%TZ}", **provenance()}
    if name in BUILT_IN:
        return {POLICY: name, LEARNED_FROM: [], **made}
    if name not in policy_names() and Path(name).is_dir():  # `..` of a link is elsewhere
        name = os.path.relpath(Path(name).resolve(), out.resolve())
    return {POLICY: name, **getattr(policy, "record", {}), **made}


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


def recorded_threads(policy: Policy, entry: Entry) -> AbstractContextManager[None]:
    """A context in which a policy uses as many CPU threads as in an entry's evaluation.

    Another number may change the last bit of a network's arithmetic. Nothing changes if the entry
    records no number, or the policy has no `using_threads`.
    """
    number = entry.details.get(THREADS)
    using: Any = getattr(policy, "using_threads", None)
    if using is None or not isinstance(number, int) or not 1 <= number <= MAX_THREADS:
        return nullcontext()
    context: AbstractContextManager[None] = using(number)
    return context
