"""PPO beside Stable-Baselines3's, the imitation learners that use it, and what these cost.

    python studies/learners/reinforcement.py ppo --out RUNS
    python studies/learners/reinforcement.py bc|gail|wgail-gp|al --demos DEMOS --out RUNS
    python studies/learners/reinforcement.py iteration --demos DEMOS --out RUNS

Needs the extras learning, report and, for `ppo`, Stable-Baselines3. Runs that are in RUNS already
are resumed or only evaluated.
"""

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from magical.evaluation import FunctionPolicy, RandomPolicy, evaluate
from magical.evaluation.policy import Policy
from magical.evaluation.statistics import rollout_mean, weighted_sum
from magical.learning import find_algorithm, train
from magical.learning.algorithms.ppo import PPOConfig
from magical.learning.config import Config
from magical.runs import is_run, read_metrics

TASK, DEMO = "MoveToRegion", "magical/MoveToRegion-Demo-v0"
PPO_STEPS = 80_000
IMITATORS = ("bc", "gail", "wgail-gp", "al")
COLOURS = {"SB3's PPO": "#4a86ad"}  # others: the first colour

Curve = Sequence[tuple[int, float]]  # environment steps, score of recent episodes


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    others = {"ppo": compare_ppo, "iteration": time_iterations}
    parser.add_argument("what", choices=(*IMITATORS, *others))
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--demos", default="")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--workers", type=int, default=None)
    parser.add_argument("--figure", type=Path, default=None)
    args = parser.parse_args()
    others.get(args.what, imitate)(args)


def compare_ppo(args: argparse.Namespace) -> None:
    """States and the dense reward; both bootstrap at the time limit, with the same settings."""
    curves: dict[str, list[Curve]] = {"ppo": [], "SB3's PPO": []}
    for seed in args.seeds:
        config = ppo_config(seed, args.workers)
        policy, curve = trained(config, args.out / f"ppo-{seed}")
        curves["ppo"].append(curve)
        print(f"ppo, seed {seed}: Demo {demo_scores(policy, args.workers).mean():.2f}", flush=True)
        policy, curve = train_sb3(config)
        curves["SB3's PPO"].append(curve)
        score = demo_scores(policy, args.workers, "state").mean()
        print(f"SB3's PPO, seed {seed}: Demo {score:.2f}", flush=True)
    plot(args.figure, curves)


def imitate(args: argparse.Namespace) -> None:
    """Pixels, 25 demonstrations, preset `quick`; 100 rollouts beside as many of a random policy."""
    random = demo_scores(RandomPolicy(), args.workers)
    print(f"random: Demo {random.mean():.2f}", flush=True)
    curves: list[Curve] = []
    for seed in args.seeds:
        fields = {} if args.what == "bc" else {"workers": args.workers}
        config = imitation_config(args.what, args.demos, seed=seed, num_demos=25, **fields)
        policy, curve = trained(config, args.out / f"{args.what}-{seed}")
        scores = demo_scores(policy, args.workers)
        gain = weighted_sum([rollout_mean(scores), rollout_mean(random)], [1.0, -1.0])
        print(
            f"{args.what}, seed {seed}: Demo {scores.mean():.2f}, above random by "
            f"{gain.value:.2f} [{gain.low:.2f}, {gain.high:.2f}]",
            flush=True,
        )
        curves.append(curve)
    if args.what != "bc":
        plot(args.figure, {args.what: curves})


def time_iterations(args: argparse.Namespace) -> None:
    """Medians over a few updates after the first."""
    for preset, updates in (("quick", 6), ("paper", 2)):
        config = imitation_config("gail", args.demos, preset, num_demos=2, workers=args.workers)
        folder = args.out / f"iteration-{preset}"
        train(config, folder, stop_after=updates, resume=is_run(folder))
        rows = read_metrics(folder)[1:]
        parts = {
            part: float(np.median([row[f"{part}_seconds"] for row in rows]))
            for part in ("sample", "policy", "discriminator")
        }
        shown = ", ".join(f"{part} {seconds:.2f} s" for part, seconds in parts.items())
        print(f"gail {preset}: {sum(parts.values()):.2f} s an update; {shown}", flush=True)


def ppo_config(seed: int, workers: int | None) -> PPOConfig:
    return PPOConfig.preset(
        "quick",
        tasks=(TASK,),
        observation="state",
        total_steps=PPO_STEPS,
        seed=seed,
        device="cpu",
        evaluate_every=0,
        workers=workers,
    )


def imitation_config(name: str, demos: str, preset: str = "quick", **fields: Any) -> Config:
    kind = find_algorithm(name).config
    return kind.preset(preset, tasks=(TASK,), demos=demos, device="cpu", **fields)


def trained(config: Config, folder: Path) -> tuple[Policy, Curve]:
    """The policy of a run that is started, resumed or there, and its curve."""
    result = train(config, folder, resume=is_run(folder), progress=True)
    rows = [row for row in read_metrics(folder) if "environment_steps" in row]
    return result.policy(), [(r["environment_steps"], r["score"]) for r in rows if "score" in r]


def train_sb3(config: PPOConfig) -> tuple[Policy, Curve]:
    """Stable-Baselines3's PPO with the same settings.

    Its policy and value networks share nothing, and it normalises advantages minibatch by
    minibatch; everything else is alike.
    """
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.env_util import make_vec_env

    torch.set_num_threads(1)
    options = {"observation": "state", "reward": "dense"}
    envs = make_vec_env(DEMO, config.ppo.num_envs, env_kwargs=options)
    curve: list[tuple[int, float]] = []
    model = PPO(
        "MlpPolicy",
        envs,
        learning_rate=lambda left: config.ppo.learning_rate * left,
        clip_range=lambda left: config.ppo.clip_range * left,
        n_steps=config.ppo.num_steps,
        batch_size=config.ppo.minibatch_size,
        n_epochs=config.ppo.epochs,
        gamma=config.ppo.gamma,
        gae_lambda=config.ppo.gae_lambda,
        ent_coef=config.ppo.ent_coef,
        vf_coef=0.5,  # of the squared error
        max_grad_norm=config.ppo.max_grad_norm,
        policy_kwargs={"net_arch": [256], "activation_fn": torch.nn.ReLU},
        seed=config.seed,
        device="cpu",
    )
    model.learn(config.ppo.total_steps, callback=recorder(curve))
    envs.close()
    policy = FunctionPolicy(lambda shown, ids, rng: model.predict(shown)[0])
    return policy, curve


def recorder(curve: list[tuple[int, float]]) -> Callable[[Any, Any], bool]:
    """Notes the mean score of the last 100 episodes whenever some have ended."""
    scores: list[float] = []

    def note(local: dict[str, Any], _: Any) -> bool:
        ended = [info["eval_score"] for info in local["infos"] if info["TimeLimit.truncated"]]
        scores.extend(ended)
        if ended:
            curve.append((local["self"].num_timesteps, float(np.mean(scores[-100:]))))
        return True

    return note


def demo_scores(
    policy: Policy, workers: int | None, observation: str | None = None
) -> NDArray[np.float64]:
    """The scores (100,) of rollouts on Demo."""
    scores = evaluate(policy, [DEMO], workers=workers, observation=observation)
    return np.array([score.score for score in scores])


def plot(path: Path | None, curves: dict[str, list[Curve]]) -> None:
    """Score of recent training episodes over environment steps, a line a seed."""
    if path is None:
        return
    figure = Figure(figsize=(6.4, 3.4), layout="constrained")
    axes = figure.subplots()
    for name, lines in curves.items():
        for number, line in enumerate(lines):
            label = None if number else name
            axes.plot(
                *zip(*line, strict=True),
                color=COLOURS.get(name, "#c8467c"),
                linewidth=1.2,
                label=label,
            )
    axes.axhline(0.9, color="0.6", linewidth=0.8, linestyle=":")
    axes.set(xlabel="environment steps", ylabel="score, last 100 episodes", ylim=(0, 1.02))
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, loc="lower right")
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
