"""What program-bc loses to perception, to the choice of programs and to control.

python -m studies.intent.oracles RUN... [--variant Demo] [--rollouts 50] [--truths control]

Each of the three is replaced by the truth: true poses in place of parsed ones, the task's own
program in place of the belief, the scripted expert's driving and carrying in place of the planner.
With "one goal" the policy acts on the most probable goal of each scene alone.
"""

import argparse
from collections.abc import Sequence

import numpy as np
import torch

from magical.envs import EnvId
from magical.evaluation import environments, evaluate
from magical.evaluation.policy import Actions, Mask
from magical.evaluation.protocol import NUDGE
from magical.scene import NOOP, Poses, State
from magical.scene.constants import FRAME_SIZE
from magical.scene.poses import ROBOT
from magical_baselines.policy import load_policy
from magical_goals.intent.acting import Intention
from magical_goals.intent.demonstrator import parsed_poses, parsed_scene
from magical_goals.intent.posterior import Belief, Explanation
from magical_goals.language.programs import program_of
from magical_goals.objects.control import ROBOT_TARGET
from magical_goals.objects.data import track
from magical_goals.objects.parser import ParsedFrames, Perception
from magical_goals.planning.planner import Planner, Situation
from magical_goals.program_bc import ProgramPolicy
from studies.objects.object_truth import ExpertEpisode

PARTS = "perception", "program", "control"
ROWS = ("nothing", *PARTS, "program+control", "+".join(PARTS))
ONE_GOAL = "one goal"  # in place of all that are believed


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("runs", nargs="+", help="run folders of program-bc")
    parser.add_argument("--variant", default="Demo")
    parser.add_argument("--rollouts", type=int, default=50)
    parser.add_argument(
        "--truths", nargs="+", default=ROWS, help=f"such as program+control, or {ONE_GOAL!r}"
    )
    args = parser.parse_args()
    torch.set_num_threads(1)
    policies = [load_policy(run, device="cpu") for run in args.runs]
    tasks = [task for policy in policies for task in policy.tasks]
    print("| True | " + " | ".join(tasks) + " | mean |")
    print("| --- " * (len(tasks) + 2) + "|")
    for truths in args.truths:
        means = []
        for policy in policies:
            if not isinstance(policy, ProgramPolicy):
                raise SystemExit("expected runs of program-bc")
            oracle = OraclePolicy(policy, truths.split("+"))
            env_ids = environments(policy.tasks, [args.variant])
            scores = evaluate(oracle, env_ids, rollouts=args.rollouts, nudge=NUDGE, workers=1)
            means += [
                np.mean([row.score for row in scores if row.env_id.task == task])
                for task in policy.tasks
            ]
        cells = " | ".join(f"{mean:.2f}" for mean in [*means, np.mean(means)])
        print(f"| {truths} | {cells} |", flush=True)


class OraclePolicy:
    """A trained `program-bc` some of whose parts are replaced by the truth."""

    privileged = True

    def __init__(
        self,
        policy: ProgramPolicy,
        truths: Sequence[str],
        beliefs: dict[str, Belief] | None = None,
    ) -> None:
        self.tasks = policy.tasks
        self._truths, self._network = truths, policy.network
        self._beliefs = beliefs or {
            task: policy.network.belief(k) for k, task in enumerate(self.tasks)
        }
        if "program" in truths:
            self._beliefs = {
                task: Belief([Explanation(program_of(task), 1.0)], 0.0, 1.0) for task in self.tasks
            }
        self._episodes: list[_Episode | None] = []

    def reset(self, mask: Mask) -> None:
        """Forget the episodes that begin again."""
        if mask.all():
            self._episodes = [None] * len(mask)
        for row in np.flatnonzero(mask):
            self._episodes[row] = None

    def act(
        self, observations: Sequence[State], env_ids: Sequence[EnvId], rng: np.random.Generator
    ) -> Actions:
        """One action for each state."""
        actions = []
        uniforms = rng.random(len(env_ids))
        for row, (state, env_id) in enumerate(zip(observations, env_ids, strict=True)):
            episode = self._episodes[row]
            if episode is None:
                belief, planner = self._beliefs[env_id.task], Planner(self._network.motion)
                parts = belief, planner, self._network.perception
                episode = _Episode(env_id.task, state, *parts, self._truths)
                self._episodes[row] = episode
            actions.append(episode.act(state, uniforms[row]))
        return np.array(actions)


class _Episode:
    """The belief in an episode, and who acts by it."""

    def __init__(
        self,
        task: str,
        state: State,
        belief: Belief,
        planner: Planner,
        perception: Perception,
        truths: Sequence[str],
    ) -> None:
        self._truths, self._planner, self._perception = truths, planner, perception
        self._expert = ExpertEpisode(task, state, seed=0)
        self._parsed = self._parse(state)
        scene = state.scene if "perception" in truths else parsed_scene(self._parsed, 0)
        self._intention = Intention(belief, scene)
        if ONE_GOAL in truths:
            self._intention.goals = [(goal, 1.0) for goal, _ in self._intention.goals[:1]]
        self._before = self._poses(state).bodies[ROBOT]

    def act(self, state: State, uniform: float) -> int:
        """The next action's number."""
        poses = self._poses(state)
        pose, before = poses.bodies[ROBOT], self._before
        self._before = pose
        decision = self._intention.decide(poses) if self._intention.is_known else None
        if decision is None:
            return NOOP
        target, place = decision
        if "control" in self._truths:
            at = None if target == ROBOT_TARGET else poses.blocks[target, :2]
            return self._expert.pursue(state, at, place)
        seen = Situation(pose, before, poses.blocks[:, :2], target, np.array(place))
        return self._planner.act(seen, uniform)

    def _poses(self, state: State) -> Poses:
        if "perception" in self._truths:
            return state.poses
        pair = track(ParsedFrames.joined([self._parsed, self._parse(state)]))
        self._parsed = pair.select(slice(1, 2))
        return parsed_poses(self._parsed, 0, self._intention.scene)

    def _parse(self, state: State) -> ParsedFrames:
        frame = np.empty((1, FRAME_SIZE, FRAME_SIZE, 3), np.uint8)
        self._expert.renderer.render(state.poses.bodies, frame[0])
        return self._perception(frame)


if __name__ == "__main__":
    main()
