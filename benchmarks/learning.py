"""Training speed of behavioural cloning beside plain PyTorch, in the same run, interleaved.

- plain: the same layers, float32, channels first, one prepared batch again and again
- ours: channels last and the faster precision, one prepared batch again and again
- whole: ours with sampling and augmenting every batch, as `magical train bc` does
- data: which share of a step sampling and augmenting take, (whole - ours) / whole

python benchmarks/learning.py [--network paper|small] [--rounds 5] [--batch-size 32]
"""

import argparse
import time
from collections.abc import Callable, Iterable
from functools import partial
from itertools import repeat

import numpy as np
import torch
from torch import nn
from torch.optim import SGD

from magical.learning.algorithms.bc import Batch, BCConfig, bc_loss, make_optimizer, make_policy
from magical.learning.augment import augment
from magical.learning.devices import Compute, choose_compute, choose_device
from magical.learning.networks import find_network
from magical.learning.prefetch import prefetch
from magical.scene import NUM_ACTIONS

FRAMES = 1000  # about ten demonstrations
STEPS = {"paper": 6, "small": 30}  # in a round
PRESETS = {"paper": "paper", "small": "quick"}


class Setup:
    """One network's configuration, data and measured batches."""

    def __init__(self, network: str, batch_size: int, device: str) -> None:
        self.config = BCConfig.preset(
            PRESETS[network], tasks=("MoveToCorner",), demos="", batch_size=batch_size
        )
        self.device = device
        rng = np.random.default_rng(0)
        frames = rng.integers(0, 256, (FRAMES, 3, 96, 96), dtype=np.uint8)
        self.frames = torch.from_numpy(frames).to(device)
        self.actions = torch.from_numpy(rng.integers(0, NUM_ACTIONS, batch_size)).to(device)
        self.tasks = torch.zeros(batch_size, dtype=torch.int64, device=device)

    def batch(self, number: int) -> Batch:
        """Sampled and augmented, as `ExpertData.images` and `augment` do it."""
        rng = np.random.default_rng(number)
        size = self.config.batch_size
        moments = torch.from_numpy(rng.integers(0, FRAMES, size * 4)).to(self.device)
        images = self.frames.index_select(0, moments).view(size, 12, 96, 96)
        images = augment(images, self.config.augmentations, rng)
        return Batch(images, self.actions, self.tasks)


def our_step(setup: Setup, compute: Compute) -> Callable[[Batch], None]:
    """The update of `bc.train`."""
    network = make_policy(setup.config).to(setup.device)
    optimizer = make_optimizer(setup.config, network)

    def step(batch: Batch) -> None:
        with compute.autocast():
            logits = network(batch.images, batch.tasks)
        loss = bc_loss(logits, batch.actions)
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()

    return step


def plain_step(setup: Setup) -> Callable[[Batch], None]:
    """The same layers in plain PyTorch."""
    layers: list[nn.Module] = []
    architecture = find_network(setup.config.network)
    channels = 12
    for out, kernel, stride in architecture.CONVOLUTIONS:  # type: ignore[attr-defined]
        convolution = nn.Conv2d(channels, out, kernel, stride, kernel // 2, bias=False)
        layers += [convolution, nn.ReLU(), nn.BatchNorm2d(out)]
        channels = out
    layers.append(nn.Flatten())
    inputs = nn.Sequential(*layers)(torch.zeros(2, 12, 96, 96)).shape[1]
    for size in architecture.HIDDEN:
        layers += [nn.Linear(inputs, size), nn.ReLU()]
        inputs = size
    network = nn.Sequential(*layers, nn.Linear(inputs, NUM_ACTIONS)).to(setup.device)
    optimizer = SGD(network.parameters(), 1e-3, momentum=0.1)

    def step(batch: Batch) -> None:
        loss = nn.functional.cross_entropy(network(batch.images), batch.actions)
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()

    return step


def seconds(step: Callable[[Batch], None], batches: Iterable[Batch], device: str) -> float:
    """Wall time of a step on average."""
    start, count = time.perf_counter(), 0
    for batch in batches:
        step(batch)
        count += 1
    if device == "cuda":
        torch.cuda.synchronize()
    return (time.perf_counter() - start) / count


def measure(network: str, rounds: int, batch_size: int) -> None:
    """Print one network's figures."""
    device, steps = choose_device("auto"), STEPS[network]
    setup = Setup(network, batch_size, device)
    fixed = setup.batch(0)
    plain_batch = fixed._replace(images=fixed.images.contiguous())
    compute = choose_compute(device, "auto", 0)
    plain, ours = plain_step(setup), our_step(setup, compute)
    for step, batch in ((plain, plain_batch), (ours, fixed)):
        step(batch)  # warm-up
    times: dict[str, list[float]] = {"plain": [], "ours": [], "whole": []}
    for _ in range(rounds):
        times["plain"].append(seconds(plain, repeat(plain_batch, steps), device))
        times["ours"].append(seconds(ours, repeat(fixed, steps), device))
        with prefetch(setup.batch, range(steps), True) as batches:
            times["whole"].append(seconds(ours, batches, device))
    median = {name: float(np.median(values)) for name, values in times.items()}
    speeds = "  ".join(f"{name} {batch_size / t:7.1f}" for name, t in median.items())
    share = 1.0 - median["ours"] / median["whole"]
    print(
        f"{network:6} {device} {compute.precision:9} samples/s: {speeds}  "
        f"ours/plain {median['plain'] / median['ours']:.2f}  "
        f"whole/plain {median['plain'] / median['whole']:.2f}  data {share:.0%}"
    )


def main() -> None:
    """Measure the networks asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--network", choices=tuple(PRESETS), action="append")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--batch-size", type=int, default=32)
    arguments = parser.parse_args()
    print(f"torch {torch.__version__}, {torch.get_num_threads()} threads")
    run = partial(measure, rounds=arguments.rounds, batch_size=arguments.batch_size)
    for network in arguments.network or PRESETS:
        run(network)


if __name__ == "__main__":
    main()
