"""What can be shown: an episode that is being played, a recorded one; frames as WebP files."""

import io
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from magical.demos import Actor, Trajectory
from magical.demos.record import recorded_trajectory
from magical.envs import EnvId
from magical.envs.env import MagicalEnv
from magical.envs.keys import controls_of
from magical.render import render_frame
from magical.scene import Poses, Scene, View
from magical.scene.constants import CONTROL_RATE, RAW_FRAME_SIZE

RECORDER = "magical play"  # in the metadata of episodes
SIZE = RAW_FRAME_SIZE  # pixels: height, and width of each view
SAMPLES = 2  # across a pixel, for smooth edges
GAP = 8  # white pixels between two views of this size; proportionally less for smaller frames
UNKNOWN = "–"  # in place of a fact

VIEWS: Mapping[str, tuple[View, ...]] = {
    "allo": (View.ALLO,),
    "ego": (View.EGO,),
    "both": (View.EGO, View.ALLO),
}


class PlayedEpisode:
    """An episode from its reset on, with all data needed to store it."""

    def __init__(self, env_id: EnvId, seed: int) -> None:
        self.env_id, self.seed = env_id, seed
        self.env = MagicalEnv(env_id.task, env_id.variant, observation="state")
        self.env.reset(seed=seed)
        self.scene, self.length = self.env.state().scene, self.env.horizon
        self.steps = 0  # control steps so far
        self.executed: list[str] | None = None  # the last action in words
        self.actions: list[int] = []
        self.actors: list[Actor] = []  # who chose each action
        self.policy_actions: list[int] = []  # chosen by the watched policy, if any
        self._bodies: list[NDArray[np.float64]] = []
        self._look()

    def _look(self) -> None:
        self.state = self.env.state()
        self._bodies.append(self.state.bodies)
        self.score = self.env.scores().score

    def act(self, action: int, actor: Actor, policy_action: int | None = None) -> None:
        """Step the environment: `actor` chose `action`; the watched policy, if any, another one."""
        self.env.step(action)
        self.steps, self.executed = self.steps + 1, in_words(action)
        self.actions.append(action)
        self.actors.append(actor)
        if policy_action is not None:
            self.policy_actions.append(policy_action)
        self._look()

    def facts(self) -> dict[str, str]:
        """What the page shows beside the picture."""
        return {
            "Time left": f"{(self.length - self.steps) / CONTROL_RATE:.1f} s",
            "Score": f"{self.score:.2f}",
            "Last action": joined(self.executed),
        }

    def frame(self, view: str) -> bytes:
        """The current frame as a WebP file."""
        return render_webp(self.scene, self.state.poses, view)

    def trajectory(self, demonstrator: str, view: str, policy: str | None = None) -> Trajectory:
        """The episode as a person's demonstration, in a view, with or without a watched policy."""
        metadata = {"recorder": RECORDER, "view": view, **({"policy": policy} if policy else {})}
        trajectory = recorded_trajectory(
            self.env, self._bodies, seed=self.seed, demonstrator=demonstrator, metadata=metadata
        )
        if policy is None:
            return trajectory
        actors, chosen = np.array(self.actors, np.uint8), np.array(self.policy_actions)
        return replace(trajectory, actors=actors, policy_actions=chosen)


class RecordedEpisode:
    """A stored episode, shown step by step."""

    def __init__(self, trajectory: Trajectory) -> None:
        self.trajectory = trajectory
        self.env_id, self.seed, self.scene = trajectory.env_id, trajectory.seed, trajectory.scene
        self.length = len(trajectory)
        self.steps = 0  # the step that is shown

    @property
    def executed(self) -> list[str] | None:
        """The action that led to the step, in words; `None` for the first."""
        return self._action(self.trajectory.actions)

    def facts(self) -> dict[str, str]:
        """What the page shows beside the picture: of the step, and of the episode."""
        episode = self.trajectory
        facts = {"Step": f"{self.steps} of {self.length}"}
        if episode.poses is not None:
            score = episode.task.score(episode.scene, Poses(episode.poses[self.steps]))
            facts["Score"] = f"{score:.2f}"
        taken = episode.actions, episode.expert_actions, episode.policy_actions
        for name, actions in zip(("Last action", "To imitate", "Policy chose"), taken, strict=True):
            if actions is not None:
                facts[name] = joined(self._action(actions))
        if episode.actors is not None:
            actor = Actor(int(episode.actors[self.steps - 1]))
            facts["Acted"] = actor.name.lower() if self.steps else UNKNOWN
        facts["By"] = episode.demonstrator
        if "policy" in episode.metadata:
            facts["Policy"] = str(episode.metadata["policy"])
        if episode.poses is None:
            facts["Final score"] = f"{episode.published_code_score:.2f} by the published code"
        return facts

    def frame(self, view: str) -> bytes:
        """The step's frame as a WebP file; of a recording of frames, in what views it has."""
        episode = self.trajectory
        if episode.poses is not None:
            return render_webp(episode.scene, Poses(episode.poses[self.steps]), view)
        frames = episode.frames or {}
        shown = [frames[name] for name in VIEWS[view] if name in frames] or list(frames.values())
        return encode_webp([recorded[self.steps] for recorded in shown])

    def _action(self, actions: NDArray[Any]) -> list[str] | None:
        return in_words(actions[self.steps - 1].tolist()) if self.steps else None


def in_words(action: int | list[float]) -> list[str]:
    """The controls that produce an action, or the parts of one given as (drive, turn, grip)."""
    if isinstance(action, int):
        return list(controls_of(action))
    named = zip(("drive", "turn", "grip"), action, strict=True)
    return [f"{name} {part:.2f}" for name, part in named]


def joined(words: list[str] | None) -> str:
    """An action in words as one text; `None`: there was no action."""
    return UNKNOWN if words is None else " + ".join(words) or "none"


def render_webp(scene: Scene, poses: Poses, view: str) -> bytes:
    """A scene in a view of `VIEWS` as a WebP file."""
    return encode_webp([render_frame(scene, poses, one, SIZE, SAMPLES) for one in VIEWS[view]])


def encode_webp(frames: Sequence[NDArray[np.uint8]]) -> bytes:
    """Frames (H, W, 3) of equal height, from left to right, as one lossless WebP file."""
    height = len(frames[0])
    gap = np.full((height, GAP * height // SIZE, 3), 255, np.uint8)
    parts = [part for frame in frames for part in (gap, frame)]
    file = io.BytesIO()
    pixels = np.concatenate(parts[1:], axis=1)
    # With the least compression effort: a page gets eight files a second.
    Image.fromarray(pixels).save(file, "WEBP", lossless=True, quality=0, method=0)
    return file.getvalue()
