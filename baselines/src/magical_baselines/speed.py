"""Training speed by precision and number of threads, for choosing a run's options."""

import time
from collections.abc import Callable, Sequence

import torch

from magical.tasks import TASKS
from magical_baselines.algorithms.bc import BCConfig, bc_loss, make_policy
from magical_baselines.compute import Compute, choose_device, cpu_threads, full_float32
from magical_baselines.models import PolicyNetwork

WARM_UP = 2  # batches before the first that is timed


def training_speeds(
    network: str = "paper",
    batch_size: int = 32,
    device: str = "auto",
    rounds: int = 5,
    threads: Sequence[int] = (),
    clock: Callable[[], float] = time.perf_counter,
    observation: str = "LoRes4E",
) -> dict[Compute, float]:
    """Measure samples per second, forward and backward, for each way to compute on this machine.

    Both precisions are measured, on a CPU with several numbers of threads. They take turns, so that
    other load on the machine affects all alike; the fastest batch of each counts.

    Args:
        network: the name of an architecture, used with batch norm.
        batch_size: samples per batch.
        device: `auto`, `cpu` or `cuda`.
        rounds: number of timed batches of each.
        threads: numbers of CPU threads; by default 1 and PyTorch's own.
        clock: the timer; `time.process_time` gives the speed of one thread on an idle machine.
        observation: what the network observes, in our first task.

    Raises:
        DeviceError: `cuda` was requested but is not available.
    """
    chosen = choose_device(device)
    config = BCConfig.preset(
        "paper",
        tasks=tuple(TASKS)[:1],
        demos="",
        network=network,
        batch_size=batch_size,
        observation=observation,
        augment="none",
    )
    policy = make_policy(config).to(chosen)
    counts = sorted(set(threads) or {1, torch.get_num_threads()}) if chosen == "cpu" else [0]
    ways = [Compute(chosen, name, count) for name in ("float32", "bfloat16") for count in counts]
    fastest = dict.fromkeys(ways, float("inf"))
    with cpu_threads(0), full_float32():
        for number in range(WARM_UP + rounds):
            for way in ways:
                seconds = _batch_time(way, policy, config, clock)
                if number >= WARM_UP:
                    fastest[way] = min(fastest[way], seconds)
    return {way: batch_size / seconds for way, seconds in fastest.items()}


def _batch_time(
    compute: Compute, policy: PolicyNetwork, config: BCConfig, clock: Callable[[], float]
) -> float:
    """The time of a forward and backward pass in seconds."""
    compute.set_threads()
    device = compute.device
    images = torch.zeros(config.batch_size, *config.input_shape, device=device)
    tasks = torch.zeros(config.batch_size, dtype=torch.int64, device=device)
    start = clock()
    with compute.autocast():
        logits = policy(images, tasks)
    torch.autograd.backward(bc_loss(logits, tasks).float())
    if device == "cuda":
        torch.cuda.synchronize()
    return clock() - start
