"""The policies that can be watched, the scripted expert and runs; one that acts in an episode."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from magical import get_task
from magical.demos import Actor
from magical.envs import EnvId
from magical.errors import PolicyError, RunFolderError
from magical.evaluation import load_policy
from magical.evaluation.policy import observation_for
from magical.experts import EpisodeExpert, expert_for, strategy_seed
from magical.observe import make_spec
from magical.observe.arrays import map_arrays
from magical.runs import is_run
from magical.scene import NUM_ACTIONS, State

EXPERT = "expert"  # the name of the first policy
MAX_DEPTH = 3  # levels of folders below a given one that are searched for runs

# Called in every state of one episode, in order, with the action that led to it, if any.
Chooser = Callable[[State, int | None], int]


class Policies:
    """The policies of a server by number: 0 is the expert, then the runs in the given folders.

    Args:
        folders: run folders, or folders with run folders in them.

    Raises:
        RunFolderError: a folder does not exist.
    """

    def __init__(self, folders: Sequence[Path] = ()) -> None:
        for folder in folders:
            if not folder.is_dir():
                raise RunFolderError(f"{folder}: expected a folder with runs, found none")
        self._roots = folders
        self._runs: list[Path] = []

    def names(self) -> list[str]:
        """The names of all policies, including runs added since; numbers do not change."""
        found = dict.fromkeys(run for root in self._roots for run in find_runs(root))
        self._runs += [run for run in found if run not in self._runs]
        return [EXPERT, *map(str, self._runs)]

    def driver(self, number: int, env_id: EnvId, seed: int) -> "Driver":
        """A policy that begins an episode; raises `PolicyError` if there is none of the number.

        Args:
            number: of the policy.
            env_id: the episode's environment.
            seed: seeds the expert's strategy, and the sampling of actions.
        """
        if number > len(self._runs):
            raise PolicyError(f"policy: expected a number up to {len(self._runs)}, found {number}")
        if number == 0:
            return Driver(0, EXPERT, Actor.EXPERT, lambda: expert_chooser(env_id, seed))
        run = self._runs[number - 1]
        return Driver(number, str(run), Actor.POLICY, lambda: run_chooser(run, env_id, seed))


def find_runs(root: Path) -> list[Path]:
    """The run folders at or below a folder, at most `MAX_DEPTH` levels deep, in order."""
    if is_run(root):
        return [root]
    below = (root.glob("/".join("*" * depth)) for depth in range(1, MAX_DEPTH + 1))
    return sorted(path for paths in below for path in paths if is_run(path))


class Driver:
    """A policy in one episode, which is asked for its choice in every state, whoever acts.

    Args:
        number: its number among the server's policies.
        name: its name.
        actor: what recordings call it.
        load: returns what chooses its actions; called when the first action is needed.
    """

    def __init__(self, number: int, name: str, actor: Actor, load: Callable[[], Chooser]) -> None:
        self.number, self.name, self.actor = number, name, actor
        self.is_asked = False
        self.choice: int | None = None  # in the current state
        self.error: Exception | None = None  # why there will be no choice
        self._load = load
        self._choose: Chooser | None = None

    def ask(self, state: State, executed: int | None) -> None:
        """Let the policy choose in the next state, to which an action led unless it is the first.

        The first call may take seconds: it should be made in a thread.
        """
        try:
            self._choose = self._choose or self._load()
            self.choice = self._choose(state, executed)
        except Exception as error:  # a policy may fail in any way; the session goes on
            self.error = error


def expert_chooser(env_id: EnvId, seed: int) -> Chooser:
    """The expert in an episode in which others may also act; raises `NoExpertError`."""
    expert = EpisodeExpert(expert_for(env_id.task, seed=strategy_seed(env_id.variant, seed)))

    def choose(state: State, executed: int | None) -> int:
        if executed is not None:
            expert.note_executed(executed)
        return expert.act(state)

    return choose


def run_chooser(run: Path, env_id: EnvId, seed: int) -> Chooser:
    """The policy of a run in an episode, from its newest checkpoint; raises as `load_policy`."""
    policy = load_policy(run.absolute())  # a relative path may be the name of another policy
    observer = make_spec(observation_for(policy), get_task(env_id.task)).observer()
    rng = np.random.default_rng([seed, 1])  # the scene's generator has the seed alone
    policy.reset(np.ones(1, np.bool_))

    def choose(state: State, executed: int | None) -> int:
        if executed is None:
            observer.start(state.scene, state.bodies)
        else:
            observer.update(state.bodies)
        observation = map_arrays(lambda array: array[None], observer.out)
        actions = np.asarray(policy.act(observation, [env_id], rng))
        if actions.shape != (1,) or actions[0] not in range(NUM_ACTIONS):
            raise PolicyError(
                f"expected an action from 0 to {NUM_ACTIONS - 1}, found {actions.tolist()}"
            )
        return int(actions[0])

    return choose
