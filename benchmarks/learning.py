r"""Measures behavioural cloning end to end: making batches and learning from them.

    python benchmarks/learning.py
    python benchmarks/learning.py --precision float32
    ATEN_CPU_CAPABILITY=avx2 ONEDNN_MAX_CPU_ISA=AVX2 \
        python benchmarks/learning.py --precision float32

It prints the CPU time of making a batch and of learning from it, on one thread; the
fraction spent on making it; and samples per second with batches prefetched by a thread, as in
`magical train bc`, and PyTorch's default number of threads.
"""

import argparse
import tempfile
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from statistics import median

import torch

from magical.demos.generate import generate
from magical.envs import EnvId
from magical_baselines.algorithms.bc import Batch, BCConfig, make_cloning, sample_batch
from magical_baselines.compute import choose_compute
from magical_baselines.data import ExpertData, sample_demonstrations
from magical_baselines.training import Purpose, Run, prefetch, stream

TASK = "MoveToCorner"
DEMOS = 25
BATCHES = 30  # per round
WARM_UP = 5  # batches


class Setup:
    """Cloning, and its measurements."""

    def __init__(self, folder: Path, precision: str, batch_size: int) -> None:
        self.config = BCConfig.preset(
            "quick",
            tasks=(TASK,),
            demos=str(folder / "demos"),
            num_demos=DEMOS,
            batch_size=batch_size,
            precision=precision,
            device="cpu",
        )
        (folder / "run").mkdir()
        self.trainer = make_cloning(self.config, Run(folder / "run", self.config))
        self.trainer.network.train()
        found, _ = sample_demonstrations(self.config)
        spec = self.config.observation_spec
        self.data = ExpertData(found, (TASK,), spec, remove_noops=True)
        self.making: list[float] = []
        self.learning: list[float] = []
        self.whole: list[float] = []

    def make(self, number: int) -> Batch:
        return sample_batch(self.config, self.data, stream(0, Purpose.BATCHES, number))

    def learn(self, batch: Batch) -> None:
        self.trainer.update(0, batch)

    def measure(self, threads: int) -> None:
        """Measure one round of everything."""
        torch.set_num_threads(1)
        batch = self.make(0)
        self.making.append(seconds(lambda: self.make(1), time.process_time))
        self.learning.append(seconds(lambda: self.learn(batch), time.process_time))
        torch.set_num_threads(threads)
        with closing(prefetch(self.make, range(WARM_UP + BATCHES), True)) as batches:
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
        setup = Setup(folder, arguments.precision, size)
        for _ in range(arguments.rounds):
            setup.measure(threads)
    making, learning, whole = map(median, (setup.making, setup.learning, setup.whole))
    print(
        f"making {1e3 * making:.1f} ms, learning {1e3 * learning:.1f} ms, "
        f"share {making / (making + learning):.0%}, {size / whole:.0f} samples/s"
    )


if __name__ == "__main__":
    main()
