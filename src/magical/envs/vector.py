"""Many worlds at once: Gymnasium's vector environment, over worker processes."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from magical.envs.batch import Batch, BatchSpec, common_observation
from magical.envs.block import Block, SharedMemory, copy_of, row_of
from magical.envs.checks import checked_actions, checked_mask, checked_seeds, require_rows
from magical.envs.copies import Copies
from magical.envs.env import RENDER_SIZE, MagicalEnv, Reward
from magical.envs.ids import EnvId, parse_env_id
from magical.envs.infos import Infos, same_step_infos, score_infos
from magical.envs.workers import RemoteBatch, defining_modules
from magical.errors import (
    ClosedEnvironmentError,
    UnknownNameError,
    WorkerDiedError,
)
from magical.observe.spec import Observation
from magical.processes import available_cores
from magical.scene.actions import NUM_ACTIONS
from magical.scene.poses import Poses
from magical.scene.scene import Scene
from magical.scene.state import State

Bools = NDArray[np.bool_]


class MagicalVectorEnv(VectorEnv[Any, Any, NDArray[Any]]):
    """N worlds, of one or of several tasks and variants, stepped together.

    World i behaves as `MagicalEnv` of `env_ids[i]` does when it is reset with the same seed and
    given the same actions, to the last bit, however many workers there are. Observations are
    batched as Gymnasium batches them; `infos` holds `eval_score` and `published_code_score` as
    arrays with their masks.

    Args:
        env_ids: the worlds' ids, with or without a preset.
        workers: processes among which the worlds are shared out, at most one for each world; 0
            steps them in this process; None takes one for each core. They are started afresh and
            never import the main script. If one ends unexpectedly, the next call raises
            `WorkerDiedError` and the environment is closed.
        observation, horizon, reward: as for `MagicalEnv`; `observation` goes before the ids'
            preset.
        autoreset_mode: what happens after an episode's last step. NEXT_STEP: the next step
            ignores the action and begins another episode. SAME_STEP: that step already shows the
            next episode, the last observation and scores being in `infos["final_obs"]` and
            `infos["final_info"]`. DISABLED: nothing, until
            `reset(seed=..., options={"reset_mask": ended})`.
        copy: whether returned observations are the caller's to keep; otherwise they are the
            block's own arrays, which the next step or reset overwrites.
        render_mode: "rgb_array" or None.
        plugins: modules that workers import to learn of tasks from outside the package; modules
            that hold such a task are found without this.

    Raises `UnknownNameError`, `MismatchedSpacesError` for worlds that do not fit together, and
    `InvalidTaskError` for a task that workers could not find.
    """

    def __init__(
        self,
        env_ids: Sequence[str],
        workers: int | None = None,
        observation: Observation = None,
        horizon: int | None = None,
        reward: Reward = "none",
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        copy: bool = True,
        render_mode: str | None = None,
        plugins: Sequence[str] = (),
    ) -> None:
        if isinstance(env_ids, str) or not env_ids:
            raise ValueError(f"env_ids: expected a list of environment ids, found {env_ids!r}")
        if workers is not None and workers < 0:
            raise ValueError(f"workers: expected at least 0, or None, found {workers}")
        if render_mode not in (None, *MagicalEnv.metadata["render_modes"]):
            raise UnknownNameError(f"render mode {render_mode!r}: expected rgb_array or None")
        parsed = [parse_env_id(env_id) for env_id in env_ids]
        self.env_ids = tuple(str(env_id._replace(preset=None)) for env_id in parsed)
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**MagicalEnv.metadata, "autoreset_mode": self.autoreset_mode}
        self.copy = copy
        self.render_mode = render_mode
        shown = common_observation(parsed, observation)
        spec = BatchSpec(self.env_ids, shown, horizon, reward, self.autoreset_mode, copy)
        layout = spec.layout()
        self._set_spaces(layout.form.space)
        self._running = np.zeros(self.num_envs, np.bool_)
        self._scenes: list[Any] = [None] * self.num_envs
        self._batch: Batch | RemoteBatch
        self.workers = min(available_cores() if workers is None else workers, self.num_envs)
        if self.workers:
            plugins = [*plugins, *defining_modules([] if plugins else spec.tasks())]
            memory = SharedMemory(layout.size)
            self._block = Block(layout, memory.memory)
            self._batch = RemoteBatch(spec, self.workers, memory, plugins)
        else:
            self._block = Block(layout)
            self._batch = Batch(spec, range(self.num_envs), self._block)
        self._copies = Copies(self._block)

    def _set_spaces(self, single: spaces.Space[Any]) -> None:
        self.num_envs = len(self.env_ids)
        self.single_observation_space = single
        self.observation_space = batch_space(single, self.num_envs)
        self.single_action_space = spaces.Discrete(NUM_ACTIONS)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Any, Infos]:
        """Begin an episode in every world, or in those that `options["reset_mask"]` names.

        Args:
            seed: world i gets `seed + i`, or `seed[i]` of a list; None continues the world's own
                random numbers.
            options: `reset_mask`, bool (N,); `scene` and `dynamics` as for `MagicalEnv`.

        Returns:
            All worlds' observations, and `infos` masked to the worlds that were reset.

        Raises:
            InvalidSceneError, PlacementError: an episode cannot begin so.
        """
        self._require_open("reset")
        chosen = dict(options or {})
        mask = checked_mask("reset_mask", chosen.pop("reset_mask", None), self.num_envs)
        seeds = checked_seeds(seed, self.num_envs)
        super().reset(seed=seed if isinstance(seed, int) else None)
        rows = np.flatnonzero(mask).tolist()
        wanted = [(row, seeds[row]) for row in rows]
        self._begin(self._exchange(lambda: self._batch.reset(wanted, chosen), rows))
        return self._observations(-1), score_infos(np.zeros((2, self.num_envs)), mask)

    def step(
        self, actions: Any, active: Bools | None = None
    ) -> tuple[Any, NDArray[np.float64], Bools, Bools, Infos]:
        """Act in every world for one control step of 1/8 s.

        Args:
            actions: integers (N,), each from 0 to 17.
            active: bool (N,); worlds where it is False rest: nothing changes in them, and `infos`
                masks them out. By default all act.

        Raises:
            InvalidActionError: actions of a wrong shape, type or size; nothing has happened.
            ResetNeededError: a world has no running episode; nothing has happened.
        """
        self._require_open("step")
        acting = checked_mask("active", active, self.num_envs)
        require_rows("step", self._running | ~acting, self.env_ids)
        self._block.actions[:] = np.where(acting, checked_actions(actions, self.num_envs), -1)
        place = self._block.copy_to[0] = self._copies.choose()
        self._begin(self._exchange(self._batch.step, range(self.num_envs)))
        truncations = self._block.truncations.copy()
        if self.autoreset_mode is AutoresetMode.DISABLED:
            self._running[truncations] = False
        infos = self._infos(acting, truncations)
        terminations = np.zeros(self.num_envs, np.bool_)
        return (
            self._observations(place),
            self._block.rewards.copy(),
            terminations,
            truncations,
            infos,
        )

    def states(self) -> list[State]:
        """The true state of every world, for experts and privileged learners."""
        self._require_episodes("states")
        tables = self._block.tables.copy()
        counts, steps = self._block.body_counts.tolist(), self._block.steps.tolist()
        horizons = self._block.horizons.tolist()
        return [
            State(
                self._scene(i), Poses(tables[i, :n, :3]), tables[i, :n, 3:], steps[i], horizons[i]
            )
            for i, n in enumerate(counts)
        ]

    @property
    def bodies(self) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """All worlds' bodies as (N, max bodies, 6): x, y, angle and their velocities.

        Their rows are those of `Poses`; the second array, (N,), says how many are in use. Both are
        read-only views on the block, which the next step or reset overwrites.
        """
        self._require_episodes("bodies")
        tables, counts = self._block.tables.view(), self._block.body_counts.view()
        tables.flags.writeable = counts.flags.writeable = False
        return tables, counts

    @property
    def worker_process_ids(self) -> list[int]:
        """The worker processes' ids; none for `workers=0` and after closing."""
        batch = getattr(self, "_batch", None)
        return batch.process_ids if isinstance(batch, RemoteBatch) else []

    def get_state(self, index: int) -> dict[str, Any]:
        """What `MagicalEnv.get_state` gives, of world `index`."""
        self._require_episodes("get_state", index)
        row = range(self.num_envs)[index]
        state: dict[str, Any] = self._exchange(lambda: self._batch.get_state(row))
        return state

    def set_state(self, index: int, state: Mapping[str, Any]) -> Any:
        """Continue world `index` from a state, as `MagicalEnv.set_state` does.

        Returns that world's observation. Raises `InvalidStateError`.
        """
        self._require_open("set_state")
        row = range(self.num_envs)[index]
        self._begin(self._exchange(lambda: self._batch.set_state(row, state), [row]))
        return copy_of(row_of(self._block.observations, index))

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Both views of every world side by side: N arrays (384, 768, 3)."""
        if self.render_mode is None:
            return None
        from magical.render import draw_both  # drawing brings in numba: only when needed

        states = self.states()
        return tuple(draw_both(state.scene, state.poses, size=RENDER_SIZE) for state in states)

    def time_physics(self, on: bool) -> float:
        """Start or stop the workers' physics clocks; returns the seconds they have measured."""
        self._require_open("time_physics")
        return float(self._exchange(lambda: self._batch.time_physics(on)))

    def close_extras(self, **kwargs: Any) -> None:
        """End the workers; `close` calls this."""
        if hasattr(self, "_batch"):
            self._batch.close()
            del self._batch, self._block, self._copies

    def _begin(self, started: Sequence[tuple[int, Any]]) -> None:
        for row, scene in started:
            self._scenes[row] = scene
            # Only a state that was set can be one at its episode's end.
            over = self._block.steps[row] >= self._block.horizons[row]
            self._running[row] = not (over and self.autoreset_mode is AutoresetMode.DISABLED)

    def _infos(self, acting: Bools, ended: Bools) -> Infos:
        if self.autoreset_mode is AutoresetMode.SAME_STEP and ended.any():
            return same_step_infos(self._block, acting, ended)
        return score_infos(self._block.scores.copy(), acting)

    def _observations(self, place: int) -> Any:
        return self._copies.hand_out(place) if self.copy else self._block.observations

    def _scene(self, row: int) -> Scene:
        scene = self._scenes[row]
        if not isinstance(scene, Scene):  # from a worker, taken apart only when asked for
            scene = self._scenes[row] = Scene.from_dict(scene)
        return scene

    def _exchange(self, talk: Callable[[], Any], rows: Iterable[int] = ()) -> Any:
        """Let the worlds do something; should it fail, those in `rows` need a reset."""
        try:
            return talk()
        except BaseException as error:
            for row in rows:
                self._running[row], self._scenes[row] = False, None
            if isinstance(error, WorkerDiedError) or not isinstance(error, Exception):
                self.close()  # an interrupted exchange cannot be taken up again
            raise

    def _require_open(self, what: str) -> None:
        if self.closed:
            raise ClosedEnvironmentError(
                f"{what}: expected an open environment, found a closed one; make it anew"
            )

    def _require_episodes(self, what: str, index: int | None = None) -> None:
        self._require_open(what)
        begun = np.array([scene is not None for scene in self._scenes])
        if index is not None:
            begun[np.arange(self.num_envs) != range(self.num_envs)[index]] = True
        require_rows(what, begun, self.env_ids)


def make_vector_env(
    task: str, variant: str, num_envs: int = 1, observation: Observation = None, **options: Any
) -> MagicalVectorEnv:
    """What `gymnasium.make_vec("magical/<id>", num_envs=N, ...)` calls.

    `options` are `MagicalVectorEnv`'s: workers, horizon, reward, autoreset_mode, copy, ...
    """
    env_ids = [str(EnvId(task, variant))] * num_envs
    return MagicalVectorEnv(env_ids, observation=observation, **options)
