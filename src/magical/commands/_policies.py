"""Shared by the commands: the policy that an evaluated run is of."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from magical.evaluation import Policy
    from magical.report.results import Result

RECORDED = "policy"  # in an entry's details: what was evaluated


def evaluation_details(policy: str, out: Path) -> dict[str, Any]:
    """What an entry written to `out` records about the policy and about this evaluation.

    Args:
        policy: a run folder, which is recorded relative to `out`, or another policy's name.
        out: the entry's folder.
    """
    from magical.evaluation import BUILT_IN
    from magical.evaluation.sources import LEARNED_FROM
    from magical.runs import versions
    from magical.runs.machine import machine, source_commit

    made = {"versions": versions(), "commit": source_commit(), "machine": machine()}
    if Path(policy).is_dir():
        from magical.learning import read_config
        from magical.learning.description import training_details

        details = training_details(read_config(Path(policy)))
        return {RECORDED: os.path.relpath(policy, out), **details, **made}
    nothing: dict[str, Any] = {LEARNED_FROM: []} if policy in BUILT_IN else {}
    return {RECORDED: policy, **nothing, **made}


def policy_of(result: "Result") -> "Policy":
    """The policy of an evaluated run: that of its run folder, or a built-in one by name.

    Code that an entry names is not run, since entries come from anywhere.

    Raises:
        PolicyError: the entry says no such policy.
        RunFolderError, CheckpointError: the run cannot be loaded.
    """
    from magical.errors import PolicyError
    from magical.evaluation import BUILT_IN, load_policy
    from magical.runs import is_run

    name = result.entry.details.get(RECORDED)
    recorded = result.folder / name if isinstance(name, str) else None
    folder = recorded if recorded is not None and is_run(recorded) else result.run
    if folder is not None:
        from magical.learning import load_policy as load_run  # imports PyTorch

        policy: Policy = load_run(folder)
        return policy
    if name in BUILT_IN:
        return load_policy(str(name))
    raise PolicyError(
        f"{result.folder}: expected a run folder or one of {', '.join(BUILT_IN)} as the policy "
        f"that was evaluated, found {name!r}"
    )
