"""Some of a vector environment's worlds, stepped one after the other in one process."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode

from magical.envs.block import Block, BlockLayout, row_of, write_to
from magical.envs.env import Reward, observation_form
from magical.envs.episode import Episode, check_options
from magical.envs.ids import EnvId, parse_env_id
from magical.errors import InvalidSceneError, InvalidStateError, MismatchedSpacesError
from magical.observe.spec import STATE, Observation, PixelSpec
from magical.observe.vector import StateLayout
from magical.physics.clock import PhysicsClock
from magical.scene.poses import FIRST_BLOCK
from magical.scene.scene import Scene
from magical.tasks import Task, get_task

# The present observations, those before, and those being made: what training loops hold on to.
COPIES = 3
Started = list[tuple[int, Scene]]  # worlds that began an episode, and where from
Seeds = Sequence[tuple[int, int | None]]  # worlds to reset, and their seeds


@dataclass(frozen=True, slots=True)
class BatchSpec:
    """What a vector environment consists of."""

    env_ids: tuple[str, ...]  # one for each world, without presets
    observation: Observation
    horizon: int | None
    reward: Reward
    autoreset_mode: AutoresetMode
    copy: bool

    def tasks(self) -> list[Task]:
        """The worlds' tasks."""
        return [get_task(parse_env_id(env_id).task) for env_id in self.env_ids]

    def form(self) -> PixelSpec | StateLayout:
        """The observation that all worlds share.

        Raises `MismatchedSpacesError` for state vectors of different lengths.
        """
        first, *others = {task.name: task for task in self.tasks()}.values()
        for task in (first, *others):
            check_options(task, self.horizon, self.reward)
        form = observation_form(first, self.observation)
        for task in others:
            other = observation_form(task, self.observation)
            if other.space != form.space:
                raise MismatchedSpacesError(
                    "environments in one batch: expected one observation space, found "
                    f"{form.space} ({first.name}) and {other.space} ({task.name}); use a pixel "
                    "observation or a batch for each task"
                )
        return form

    def layout(self) -> BlockLayout:
        """The memory that all worlds need."""
        most_blocks = max(task.max_blocks for task in self.tasks())
        keep_final = self.autoreset_mode is AutoresetMode.SAME_STEP
        form, bodies = self.form(), FIRST_BLOCK + most_blocks
        copies = COPIES if self.copy and isinstance(form, PixelSpec) else 0
        return BlockLayout(len(self.env_ids), form, bodies, keep_final, copies)

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        form = self.form()
        return {
            "env_ids": list(self.env_ids),
            "observation": asdict(form) if isinstance(form, PixelSpec) else STATE,
            "horizon": self.horizon,
            "reward": self.reward,
            "autoreset_mode": self.autoreset_mode.value,
            "copy": self.copy,
        }

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> "BatchSpec":
        """The inverse of `to_dict`."""
        mode = AutoresetMode(data["autoreset_mode"])
        return BatchSpec(**{**data, "env_ids": tuple(data["env_ids"]), "autoreset_mode": mode})


class Batch:
    """The worlds in `rows` of a vector environment, showing themselves in its block.

    Actions are read from the block; everything else is written there. Arguments are checked by
    the vector environment, not here.
    """

    def __init__(self, spec: BatchSpec, rows: Sequence[int], block: Block) -> None:
        form, tasks = spec.form(), spec.tasks()
        self._worlds = {row: _World(spec, row, tasks[row], form, block) for row in rows}
        self._in_order = list(self._worlds.values())
        self._same_step = spec.autoreset_mode is AutoresetMode.SAME_STEP
        part = slice(rows[0], rows[-1] + 1)
        self._actions = block.actions[part]
        self._steps = block.steps[part]
        self._copy_to = block.copy_to
        self._ends = (block.rewards[part], block.truncations[part], block.scores[:, part])
        self._clock = PhysicsClock()

    def step(self) -> Started:
        """Act in every world whose action is not -1; begin anew where an episode had ended."""
        started: Started = []
        for array in self._ends:
            array.fill(0)
        np.add(self._steps, 1, out=self._steps, where=self._actions >= 0)
        place = int(self._copy_to[0])
        for world, action in zip(self._in_order, self._actions.tolist(), strict=True):
            try:
                if action >= 0 and self._advance(world, action):
                    started.append(world.reset())
            except Exception as error:
                error.add_note(f"in {world.name}")
                raise
            if place >= 0:
                world.copy_observation(place)
        return started

    def _advance(self, world: "_World", action: int) -> bool:
        """Act unless the episode has ended; returns whether to begin another."""
        if world.over:
            return True
        if not world.step(action) or not self._same_step:
            return False
        world.keep_final_observation()
        return True

    def reset(self, seeds: Seeds, options: Mapping[str, Any] | None) -> Started:
        """Begin episodes in the worlds named, each with its seed."""
        started: Started = []
        for row, seed in seeds:
            world = self._worlds[row]
            try:
                started.append(world.reset(seed, options))
            except Exception as error:
                error.add_note(f"in {world.name}")
                raise
        return started

    def get_state(self, row: int) -> dict[str, Any]:
        """What `MagicalEnv.get_state` gives."""
        world = self._worlds[row]
        return {**world.episode.save(), "rng": world.rng.bit_generator.state}

    def set_state(self, row: int, state: Mapping[str, Any]) -> Started:
        """Continue from `get_state`'s data; raises `InvalidStateError`."""
        return [self._worlds[row].restore(state)]

    def time_physics(self, on: bool) -> float:
        """Start or stop the physics clock of this process; returns the seconds it has measured."""
        if on:
            self._clock.start()
        else:
            self._clock.stop()
        return self._clock.seconds

    def close(self) -> None:
        """Let go of the worlds."""
        self._clock.stop()
        self._worlds.clear()
        self._in_order.clear()


class _World:
    """One world of a batch, and where in the block it stands."""

    def __init__(
        self, spec: BatchSpec, row: int, task: Task, form: PixelSpec | StateLayout, block: Block
    ) -> None:
        variant = parse_env_id(spec.env_ids[row]).variant
        self._shown = row_of(block.observations, row)
        self._copies = [row_of(copy, row) for copy in block.copies]
        self.name = f"environment {row} ({spec.env_ids[row]})"
        self.episode = Episode(task, variant, form, spec.horizon, spec.reward, self._shown)
        self.rng: np.random.Generator
        self.over = False  # the episode has ended; the next step begins another
        self._row = row
        self._block = block
        self._always_rewarded = spec.reward == "dense"
        self._table = block.tables[row]

    def step(self, action: int) -> bool:
        """Act; returns whether the episode has ended."""
        episode = self.episode
        self.over = episode.step(action)
        self._table[:] = episode.table
        if self.over or self._always_rewarded:
            row, block = self._row, self._block
            block.rewards[row], scores = episode.outcome(self.over)
            block.truncations[row] = self.over
            block.scores[:, row] = scores.score, scores.published_code
        return self.over

    def reset(
        self, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[int, Scene]:
        """Begin an episode as `MagicalEnv.reset` does."""
        if seed is not None or not hasattr(self, "rng"):
            self.rng, _ = seeding.np_random(seed)
        self.over = True  # should the start fail
        self.episode.start(self.rng, options)
        return self._began()

    def restore(self, state: Mapping[str, Any]) -> tuple[int, Scene]:
        """Continue as `MagicalEnv.set_state` does."""
        rng, _ = seeding.np_random()
        try:
            rng.bit_generator.state = state["rng"]
        except (KeyError, TypeError, ValueError) as error:
            raise InvalidStateError(f"saved state has no usable 'rng': {error!r}") from error
        self.episode.restore(state)
        self.rng = rng
        return self._began()

    def keep_final_observation(self) -> None:
        """Put the observation where the next episode's first one does not overwrite it."""
        write_to(row_of(self._block.final_observations, self._row), self._shown)

    def copy_observation(self, place: int) -> None:
        """Put the observation where the caller will find it."""
        write_to(self._copies[place], self._shown)

    def _began(self) -> tuple[int, Scene]:
        row, block, episode = self._row, self._block, self.episode
        scene, bodies = episode.world.scene, len(episode.table)
        if bodies > block.tables.shape[1]:
            raise InvalidSceneError(
                f"{self.name}: expected at most {block.tables.shape[1] - FIRST_BLOCK} blocks, "
                f"found {len(scene.blocks)}; remove some"
            )
        self.over = len(episode.actions) >= episode.horizon
        self._table = block.tables[row, :bodies]
        self._table[:] = episode.table
        block.body_counts[row] = bodies
        block.steps[row], block.horizons[row] = len(episode.actions), episode.horizon
        return row, scene


def common_observation(env_ids: Sequence[EnvId], observation: Observation) -> Observation:
    """The observation given, or else the preset that the ids agree on.

    Raises `MismatchedSpacesError` if they do not.
    """
    presets = {env_id.preset for env_id in env_ids}
    if observation is not None or len(presets) == 1:
        return presets.pop() if observation is None else observation
    raise MismatchedSpacesError(
        "environments in one batch: expected the same preset in all ids, found "
        f"{', '.join(sorted(map(str, presets)))}; or give observation=..."
    )
