r"""Measures behavioural cloning end to end: making batches and learning from them, four ways.

    python benchmarks/learning.py
    python benchmarks/learning.py --precision float32
    ATEN_CPU_CAPABILITY=avx2 ONEDNN_MAX_CPU_ISA=AVX2 \
        python benchmarks/learning.py --precision float32

The ways take turns in one run:

- before: the network `small`, frames resampled by PyTorch
- compiled: the network `small`, frames resampled by compiled code
- resampling: `quick`'s network, frames resampled by compiled code
- rendering: `quick`'s network, frames rendered from a moved camera

For each, it prints the CPU time of making a batch and of learning from it, on one thread; the
fraction spent on making it; and samples per second with batches prefetched by a thread, as in
`magical train bc`, and PyTorch's default number of threads.
"""

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import numpy as np
import torch
from torch import Tensor

from magical.demos.generate import generate
from magical.envs import EnvId
from magical.learning.algorithms.bc import Batch, BCConfig, BCTrainer
from magical.learning.augmentation.augment import augment_in_pytorch, sample_parameters
from magical.learning.augmentation.names import Augmentations
from magical.learning.augmentation.transformations import StackTransformations
from magical.learning.data.expert_data import ExpertData, Rows, sample_demonstrations
from magical.learning.data.prefetch import prefetch
from magical.learning.running.devices import choose_compute
from magical.learning.running.run import Run

TASK = "MoveToCorner"
DEMOS = 25
BATCHES = 30  # per round
WARM_UP = 5  # batches
RATE = 1e-3
WAYS = {
    "before": ("small", "pytorch"),
    "compiled": ("small", "resampling"),
    "resampling": (None, "resampling"),
    "rendering": (None, "rendering"),
}


class PyTorchData(ExpertData):
    """Expert data with frames resampled by PyTorch."""

    def augmented(
        self,
        rows: Rows,
        which: Augmentations,
        rng: np.random.Generator,
        transformed: StackTransformations | None = None,
        together: int = 1,
    ) -> Tensor:
        parameters = sample_parameters(len(rows), which, rng, together)
        generator = torch.Generator().manual_seed(int(rng.integers(2**63)))
        return augment_in_pytorch(self.images(rows), which, parameters, generator)


class Setup:
    """One way of cloning, and its measurements."""

    def __init__(self, name: str, folder: Path, precision: str, batch_size: int) -> None:
        network, way = WAYS[name]
        changes = {} if network is None else {"network": network}
        self.name = name
        self.config = BCConfig.preset(
            "quick",
            tasks=(TASK,),
            demos=str(folder / "demos"),
            num_demos=DEMOS,
            batch_size=batch_size,
            precision=precision,
            device="cpu",
            augment_by="rendering" if way == "rendering" else "resampling",
            **changes,
        )
        (folder / name).mkdir()
        self.trainer = BCTrainer(self.config, Run(folder / name, self.config))
        self.trainer.network.train()
        demos = self.config.demonstrations.demos
        trajectories = sample_demonstrations(demos, (TASK,), DEMOS, 0).trajectories
        self.data = self.trainer.expert_data(trajectories, remove_noops=True)
        if way == "pytorch":
            spec = self.config.observation_spec
            self.data = PyTorchData(trajectories, (TASK,), spec, remove_noops=True)
        self.making: list[float] = []
        self.learning: list[float] = []
        self.whole: list[float] = []

    def make(self, number: int) -> Batch:
        return self.trainer.sample_batch(self.data, number)

    def learn(self, batch: Batch) -> None:
        self.trainer.step(batch, RATE)

    def measure(self, threads: int) -> None:
        """Measure one round of everything."""
        torch.set_num_threads(1)
        batch = self.make(0)
        self.making.append(seconds(lambda: self.make(1), time.process_time))
        self.learning.append(seconds(lambda: self.learn(batch), time.process_time))
        torch.set_num_threads(threads)
        with prefetch(self.make, range(WARM_UP + BATCHES), True) as batches:
            for number, prepared in enumerate(batches):
                if number == WARM_UP:
                    start = time.perf_counter()
                self.learn(prepared)
        self.whole.append((time.perf_counter() - start) / BATCHES)


def seconds(function: Callable[[], object], clock: Callable[[], float]) -> float:
    """The mean duration of one call."""
    for _ in range(WARM_UP):
        function()
    start = clock()
    for _ in range(BATCHES):
        function()
    return (clock() - start) / BATCHES


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--way", nargs="+", choices=tuple(WAYS), default=list(WAYS))
    add("--precision", default="auto", help="auto, float32 or bfloat16")
    add("--rounds", type=int, default=5)
    add("--batch-size", type=int, default=32)
    arguments = parser.parse_args()
    threads = torch.get_num_threads()
    precision = choose_compute("cpu", arguments.precision, threads).precision
    print(f"torch {torch.__version__}, {precision}, {torch.backends.cpu.get_cpu_capability()}")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        generate(EnvId(TASK, "Demo"), DEMOS, folder / "demos", seed=0, min_score=1.0)
        size = arguments.batch_size
        setups = [Setup(way, folder, arguments.precision, size) for way in arguments.way]
        for _ in range(arguments.rounds):
            for setup in setups:
                setup.measure(threads)
    first = median(setups[0].whole)
    print("| way | network | making, ms | learning, ms | share | samples/s | ratio |")
    for setup in setups:
        making, learning, whole = map(median, (setup.making, setup.learning, setup.whole))
        print(
            f"| {setup.name} | {setup.config.networks.network} | {1e3 * making:.1f} "
            f"| {1e3 * learning:.1f} | {making / (making + learning):.0%} | {size / whole:.0f} "
            f"| {first / whole:.2f} |"
        )


if __name__ == "__main__":
    main()
