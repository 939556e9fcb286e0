"""Random streams: PyTorch's global generator."""

import threading

import torch

from magical_baselines.running.streams import Purpose, seed_torch, seeded_init


def test_an_initialisation_is_the_same_while_another_thread_trains() -> None:
    done = threading.Event()

    def train() -> None:
        while not done.is_set():
            seed_torch(1, Purpose.NOISE)

    def initialise() -> torch.Tensor:
        with seeded_init(0):
            return torch.cat([torch.randn(1000) for _ in range(100)])

    alone = initialise()
    thread = threading.Thread(target=train)
    thread.start()
    try:
        assert all(torch.equal(initialise(), alone) for _ in range(5))
    finally:
        done.set()
        thread.join()
