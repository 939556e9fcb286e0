"""The policies that can be watched, the scripted expert and runs; one that acts in an episode."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from magical.demos import Actor
from magical.errors import PolicyError, RunFolderError
from magical.evaluation import load_policy
from magical.evaluation.policy import observation_for
from magical.experts import EpisodeExpert, expert_for, strategy_seed
from magical.observe import make_spec, map_arrays
from magical.runs import is_run
from magical.scene import NUM_ACTIONS
from magical_play.episodes import PlayedEpisode

EXPERT = "expert"  # the name of the first policy

Chooser = Callable[[], int]  # the action in the next state of an episode, called in every state


class Policies:
    """The policies of a server by number: 0 is the expert, then the runs at or below folders.

    Raises `RunFolderError` for a folder that does not exist.
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

    def driver(self, number: int, episode: PlayedEpisode) -> "Driver":
        """A policy at the start of an episode; raises `PolicyError` if the number is unknown."""
        if number > len(self._runs):
            raise PolicyError(f"policy: expected a number up to {len(self._runs)}, found {number}")
        return Driver(self._runs[number - 1] if number else None, episode)


def find_runs(root: Path) -> list[Path]:
    """The run folders at or below a folder, at most three levels deep."""
    below = (sorted(root.glob(pattern)) for pattern in ("*", "*/*", "*/*/*"))
    return [path for level in ([root], *below) for path in level if is_run(path)]


class Driver:
    """A policy in one episode, which is asked for its choice in every state, whoever acts."""

    def __init__(self, run: Path | None, episode: PlayedEpisode) -> None:
        self.name = EXPERT if run is None else str(run)
        self.actor = Actor.EXPERT if run is None else Actor.POLICY
        self.is_asked = False
        self.choice: int | None = None  # in the current state
        self.error: Exception | None = None  # why there will be no choice
        self._run, self._episode = run, episode
        self._choose: Chooser | None = None

    def ask(self) -> None:
        """Let the policy choose. The first call may take seconds: make it in a thread."""
        try:
            if self._choose is None:
                run, episode = self._run, self._episode
                self._choose = run_chooser(run, episode) if run else expert_chooser(episode)
            self.choice = self._choose()
        except Exception as error:  # a policy may fail in any way; the session goes on
            self.error = error


def expert_chooser(episode: PlayedEpisode) -> Chooser:
    """The expert in an episode in which others may also act; raises `NoExpertError`."""
    seed = strategy_seed(episode.env_id.variant, episode.seed)
    expert = EpisodeExpert(expert_for(episode.env_id.task, seed=seed))

    def choose() -> int:
        if episode.actions:
            expert.note_executed(episode.actions[-1])
        return expert.act(episode.state)

    return choose


def run_chooser(run: Path, episode: PlayedEpisode) -> Chooser:
    """The policy of a run in an episode, from its newest checkpoint; raises as `load_policy`."""
    policy = load_policy(run.absolute())  # a relative path may be the name of another policy
    observer = make_spec(observation_for(policy), episode.env_id.task_spec).observer()
    rng = np.random.default_rng([episode.seed, 1])  # the scene's generator has the seed alone
    policy.reset(np.ones(1, np.bool_))

    def choose() -> int:
        if episode.actions:
            observer.update(episode.state.bodies)
        else:
            observer.start(episode.scene, episode.state.bodies)
        observation = map_arrays(lambda array: array[None], observer.out)
        actions = np.asarray(policy.act(observation, [episode.env_id], rng))
        if actions.shape != (1,) or actions[0] not in range(NUM_ACTIONS):
            raise PolicyError(
                f"expected an action from 0 to {NUM_ACTIONS - 1}, found {actions.tolist()}"
            )
        return int(actions[0])

    return choose
