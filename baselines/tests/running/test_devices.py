"""Device, precision and threads: the configuration and the processor decide, never the load."""

import threading
from pathlib import Path
from typing import Any

import pytest
import torch

from magical.errors import DeviceError
from magical.evaluation import evaluate
from magical_baselines import algorithm_names, find_algorithm, train
from magical_baselines.algorithms.bc import BCConfig
from magical_baselines.config import options
from magical_baselines.running.devices import (
    Compute,
    Precision,
    choose_compute,
    choose_device,
    cpu_threads,
    flushed_denormals,
    full_float32,
    has_bfloat16,
    restored_threads,
)


@pytest.mark.parametrize("ability", ["amx_bf16", "avx512_bf16"])
def test_a_processor_with_bfloat16_instructions_uses_them(
    ability: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    abilities = {"amx_bf16": False, "avx512_bf16": False}
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: abilities)
    monkeypatch.setattr(torch.backends.cpu, "get_cpu_capability", lambda: "AVX512")
    assert not has_bfloat16("cpu")
    assert choose_compute("cpu", "auto", 3) == Compute("cpu", "float32", 3)
    abilities[ability] = True
    assert choose_compute("cpu", "auto", 3) == Compute("cpu", "bfloat16", 3)
    assert choose_compute("cpu", "float32", 3) == Compute("cpu", "float32", 3)


@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
def test_inputs_are_cast_as_autocast_would(precision: Precision) -> None:
    compute = Compute("cpu", precision)
    layer, images = torch.nn.Linear(16, 4), torch.rand(3, 16)
    cast = compute.cast(images)
    assert cast.dtype == getattr(torch, precision)
    with compute.autocast():
        assert torch.equal(layer(cast), layer(images))


def test_newer_instructions_that_are_switched_off_are_not_used(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: {"amx_bf16": True})
    monkeypatch.setattr(torch.backends.cpu, "get_cpu_capability", lambda: "AVX2")
    assert not has_bfloat16("cpu")


def test_threads_are_pytorchs_own_number_unless_given() -> None:
    with restored_threads():
        torch.set_num_threads(2)
        assert choose_compute("cpu", "float32", 0).threads == 2
        assert choose_compute("cuda", "float32", 0).threads == 0


def keeps_denormals() -> bool:
    """Whether numbers below the smallest normal one are kept."""
    return bool((torch.full((64,), 2e-38) / 8.0).any())


@pytest.mark.skipif(not torch.set_flush_denormal(False), reason="the CPU always keeps denormals")
@pytest.mark.parametrize("before", [False, True])
def test_denormals_are_flushed_inside_alone(before: bool) -> None:
    torch.set_flush_denormal(before)
    try:
        with flushed_denormals():
            assert not keeps_denormals()
        assert keeps_denormals() != before
    finally:
        torch.set_flush_denormal(False)


@pytest.mark.skipif(not torch.set_flush_denormal(False), reason="the CPU always keeps denormals")
def test_denormals_are_flushed_in_training(demos: Path, tmp_path: Path) -> None:
    during: list[bool] = []
    config = BCConfig.preset(
        "quick", tasks=("MoveToCorner",), demos=str(demos), num_demos=2, network="light", batches=1
    )
    train(config, tmp_path, callback=lambda *_: during.append(keeps_denormals()))
    assert during == [False]
    assert keeps_denormals()


def float32_precisions() -> list[str]:
    """How a GPU computes with float32 in convolutions and in products of matrices."""
    cudnn: Any = torch.backends.cudnn
    return [cudnn.conv.fp32_precision, torch.backends.cuda.matmul.fp32_precision]


def test_float32_is_not_tensorfloat32_on_a_gpu(demos: Path, tmp_path: Path) -> None:
    config = BCConfig.preset(
        "paper", tasks=("MoveToCorner",), demos=str(demos), num_demos=2, network="light", batches=1
    )
    assert config.precision == "float32"
    before, during = float32_precisions(), []
    assert before[0] == "tf32"  # PyTorch's default for convolutions
    result = train(config, tmp_path, callback=lambda *_: during.extend(float32_precisions()))
    policy = result.policy()
    policy.network.register_forward_hook(lambda *_: during.extend(float32_precisions()))
    evaluate(policy, ["magical/MoveToCorner-Demo-v0"], rollouts=1, horizon=1, workers=0)
    assert set(during) == {"ieee"}
    assert float32_precisions() == before


def test_every_paper_preset_is_float32() -> None:
    fields: dict[str, Any] = {"tasks": ("MoveToCorner",), "demos": ""}
    for name in algorithm_names():
        kind = find_algorithm(name).config
        given = {option.name for option in options(kind)} & set(fields)
        for preset in kind.presets:
            config = kind.preset(preset, **{field: fields[field] for field in given})
            assert config.precision == ("auto" if preset in ("quick", "states") else "float32")


def test_overlapping_contexts_of_several_threads_leave_everything_as_it_was() -> None:
    parts = (torch.backends.cudnn.conv, torch.backends.cuda.matmul)  # type: ignore[attr-defined]
    before = torch.get_num_threads(), [part.fp32_precision for part in parts]
    began, overlaps, done = (threading.Event() for _ in range(3))

    def first() -> None:
        with cpu_threads(1), full_float32():
            began.set()
            overlaps.wait()
        done.set()

    def second() -> None:
        began.wait()
        with cpu_threads(1), full_float32():
            overlaps.set()
            done.wait()  # the other one, which began before, has ended
            assert torch.get_num_threads() == 1
            assert parts[0].fp32_precision == "ieee"

    with cpu_threads(1), cpu_threads(3):
        assert torch.get_num_threads() == 3
    threads = [threading.Thread(target=target) for target in (first, second)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    later: list[int] = []
    third = threading.Thread(target=lambda: later.append(torch.get_num_threads()))
    third.start()
    third.join()
    assert (torch.get_num_threads(), [part.fp32_precision for part in parts]) == before
    assert later == [before[0]]


def test_an_unknown_device_is_named() -> None:
    with pytest.raises(DeviceError, match="'gpu': expected one of auto, cpu, cuda"):
        choose_device("gpu")
