"""Estimates of the time of runs, against figures worked out by hand."""

from typing import Any

import pytest

from magical_baselines.compute import Compute
from magical_baselines.experiments.forecast import estimate
from magical_baselines.experiments.plan import Method, Plan, planned_runs

SPEED = 100.0  # samples a second, forward and backward
ROLLOUT_STEPS = 100 * 6 * 80  # MoveToCorner: rollouts, variants, horizon


@pytest.fixture(autouse=True)
def measured(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The networks, and what they observe, whose speed is asked for; all are equally fast."""
    networks: list[str] = []

    def speeds(
        network: str, *, threads: tuple[int, ...], observation: str, **options: Any
    ) -> dict[Compute, float]:
        networks.append(f"{network} {observation}")
        return {
            Compute("cpu", precision, threads[0]): SPEED for precision in ("float32", "bfloat16")
        }

    monkeypatch.setattr("magical_baselines.speed.training_speeds", speeds)
    monkeypatch.setattr("magical_baselines.compute.choose_device", lambda _: "cpu")
    return networks


def seconds(algorithm: str, preset: str = "paper", **settings: Any) -> float:
    method = Method(name="A", algorithm=algorithm, preset=preset, settings=settings)
    (found,) = estimate(planned_runs(Plan(methods=(method,), tasks=("MoveToCorner",))))
    return found


def test_behavioural_cloning() -> None:
    samples = 20_000 * 32
    assert seconds("bc") == pytest.approx(
        (samples + ROLLOUT_STEPS / 3) / SPEED + samples * 1.2e-3 + ROLLOUT_STEPS / 7_500
    )


def test_a_learner_without_a_network_of_the_registry_states_its_own_cost() -> None:
    expected = 6000 * 256 * 1e-4 + ROLLOUT_STEPS * (1.5e-3 + 1 / 7_500)
    assert seconds("object-bc") == pytest.approx(expected)


@pytest.mark.parametrize(
    ("algorithm", "more"),
    [
        ("ppo", 0),
        ("gail", 3906 * 12 * 24),
        ("wgail-gp", 2 * 3906 * 12 * 24),
        ("al", 2 * 8192 * 24),
    ],
)
def test_algorithms_with_ppo(algorithm: str, more: int) -> None:
    steps = 3906 * 256 + ROLLOUT_STEPS
    samples = 3906 * 256 * 12 + more
    assert seconds(algorithm) == pytest.approx((samples + steps / 3) / SPEED + steps / 7_500)


@pytest.mark.parametrize(
    ("algorithm", "preset", "network"),
    [
        ("act", "quick", "narrow LoRes4E"),
        ("bc", "paper", "paper LoRes4E"),
        ("ppo", "paper", "paper LoRes4E"),
        ("ppo", "states", "paper state"),
    ],
)
def test_every_learner_is_timed_with_its_own_network(
    measured: list[str], algorithm: str, preset: str, network: str
) -> None:
    seconds(algorithm, preset)
    assert measured == [network]


def test_learners_of_state_vectors_are_timed_in_float32(monkeypatch: pytest.MonkeyPatch) -> None:
    def speeds(network: str, *, threads: tuple[int, ...], **options: Any) -> dict[Compute, float]:
        (n,) = threads
        return {Compute("cpu", "float32", n): SPEED, Compute("cpu", "bfloat16", n): SPEED / 10}

    monkeypatch.setattr("magical_baselines.speed.training_speeds", speeds)
    monkeypatch.setattr("magical_baselines.compute.has_bfloat16", lambda _: True)
    assert seconds("ppo", "states") == seconds("ppo", "states", precision="float32")
    assert seconds("ppo", "quick") > seconds("ppo", "quick", precision="float32")
