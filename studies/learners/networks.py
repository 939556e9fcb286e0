"""Which network learns soonest: architectures beside each other, by time until Demo is solved.

    python studies/learners/networks.py --out runs/networks --network light small nature
    python studies/learners/networks.py --out runs/networks --speed
    ATEN_CPU_CAPABILITY=avx2 ONEDNN_MAX_CPU_ISA=AVX2 python studies/learners/networks.py \
        --out runs/networks --speed --precision float32

Each run is behavioural cloning with the `quick` preset and one architecture, from 25
demonstrations, evaluated on Demo after every 200 batches until the score is 0.95. The architectures
are the package's and those in `candidate_networks` beside it. `--speed` measures the processor
time of a batch on one thread, of all architectures by turns, and prints for each the processor time
until Demo is solved: the median number of batches over the seeds, times that of a batch. Finished
runs are kept in the folder.
"""

import argparse
import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import fmean, median

import numpy as np
import torch

from magical.demos.generate import generate
from magical.envs import EnvId
from magical.evaluation import evaluate
from magical_baselines import load_policy, train
from magical_baselines.algorithms.bc import BCConfig, bc_loss, make_policy
from magical_baselines.compute import choose_compute
from magical_baselines.networks import network_names

TASKS = ("MoveToCorner", "MatchRegions")
SOLVED = 0.95  # mean score
EVERY = 200  # batches between evaluations
ROLLOUTS = 40
EVALUATION_SEED = 1  # not the protocol's scenes
ROUNDS = 8  # of timing

CANDIDATES = {
    file.stem.replace("_", "-"): f"candidate_networks:{file.stem}"
    for file in sorted((Path(__file__).parent / "candidate_networks").glob("[!_]*.py"))
}


def configuration(arguments: argparse.Namespace, network: str, task: str, seed: int) -> BCConfig:
    return BCConfig.preset(
        "quick",
        tasks=(task,),
        demos=str(arguments.out / "demos" / f"{task}-{seed}"),
        num_demos=25,
        network=CANDIDATES.get(network, network),
        seed=seed,
        threads=1,
        checkpoint_every=EVERY,
        precision=arguments.precision,
    )


def curve(arguments: argparse.Namespace, network: str, task: str, seed: int) -> list[float]:
    """The scores on Demo after every 200 batches, until it is solved; those of before from disk."""
    file = arguments.out / f"{network}-{task}-{seed}.json"
    if file.exists():
        return list(json.loads(file.read_text()))
    config = configuration(arguments, network, task, seed)
    env_id = EnvId(task, "Demo")
    if not Path(config.demos).exists():
        generate(env_id, config.num_demos, config.demos, seed=seed, min_score=1.0)
    folder = file.with_suffix("")
    scores: list[float] = []
    while len(scores) * EVERY < config.num_updates and (not scores or scores[-1] < SOLVED):
        train(config, folder, resume=folder.exists(), stop_after=EVERY)
        rollouts = evaluate(
            load_policy(folder),
            [env_id],
            rollouts=ROLLOUTS,
            seed=EVALUATION_SEED,
            workers=0,
        )
        scores.append(fmean(row.score for row in rollouts))
        print(network, task, seed, len(scores) * EVERY, f"{scores[-1]:.3f}", flush=True)
    file.write_text(json.dumps(scores))
    return scores


def batches_until_solved(scores: list[float]) -> float:
    return len(scores) * EVERY if scores[-1] >= SOLVED else float("inf")


def batch_times(networks: list[str], precision: str) -> dict[str, float]:
    """Processor time of forward and backward pass and optimiser step on one thread, in seconds."""
    torch.set_num_threads(1)
    steps = {name: training_step(name, precision) for name in networks}
    times: dict[str, list[float]] = {name: [] for name in networks}
    for _ in range(ROUNDS):
        for name, step in steps.items():
            step()  # its weights into the caches
            start = time.process_time()
            step()
            times[name].append(time.process_time() - start)
    return {name: median(found) for name, found in times.items()}


def training_step(network: str, precision: str) -> Callable[[], None]:
    chosen = CANDIDATES.get(network, network)
    config = BCConfig.preset(
        "quick", tasks=TASKS[:1], demos="", network=chosen, precision=precision
    )
    policy = make_policy(config)
    optimizer = torch.optim.Adam(policy.parameters(), config.learning_rate, fused=True)
    compute = choose_compute("cpu", precision, 1)
    rng = np.random.default_rng(0)
    shape = (config.batch_size, *config.input_shape)
    images = torch.rand(shape).contiguous(memory_format=torch.channels_last)
    actions = torch.from_numpy(rng.integers(0, 18, config.batch_size))
    tasks = torch.zeros(config.batch_size, dtype=torch.int64)

    def step() -> None:
        with compute.autocast():
            logits = policy(images, tasks)
        optimizer.zero_grad()
        torch.autograd.backward(bc_loss(logits, actions))
        optimizer.step()

    return step


def table(arguments: argparse.Namespace) -> Iterator[str]:
    """A Markdown table of the architectures whose runs are there."""
    times = batch_times(arguments.network, arguments.precision)
    yield f"| network | ms a batch | {' | '.join(f'{t}: batches | s' for t in TASKS)} |"
    yield "| --- " * (2 + 2 * len(TASKS)) + "|"
    for name in sorted(arguments.network, key=times.__getitem__):
        cells = [name, f"{1e3 * times[name]:.1f}"]
        for task in TASKS:
            files = [arguments.out / f"{name}-{task}-{seed}.json" for seed in arguments.seeds]
            if not all(file.exists() for file in files):
                cells += ["", ""]
                continue
            found = [batches_until_solved(json.loads(file.read_text())) for file in files]
            numbers = ", ".join(f"{number:g}" for number in found)
            cells += [f"{median(found):g} ({numbers})", f"{median(found) * times[name]:.0f}"]
        yield f"| {' | '.join(cells)} |"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    names = [name for name in (*network_names(), *CANDIDATES) if name != "paper"]
    add("--out", type=Path, required=True, help="folder for demonstrations, runs, scores")
    add("--network", nargs="+", choices=names, default=names, metavar="NAME", help=", ".join(names))
    add("--task", nargs="+", choices=TASKS, default=list(TASKS), metavar="TASK")
    add("--seeds", nargs="+", type=int, default=[0, 1, 2], metavar="S", help="0 1 2")
    add("--precision", default="auto", help="auto, float32 or bfloat16")
    add("--speed", action="store_true", help="measure the time of a batch; print the table")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    if arguments.speed:
        print(*table(arguments), sep="\n")
        return
    for seed in arguments.seeds:
        for task in arguments.task:
            for network in arguments.network:
                curve(arguments, network, task, seed)


if __name__ == "__main__":
    main()
