"""Frozen encoders as networks: frame by frame, resized, normalised, in no checkpoint."""

import json
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import pytest
import torch
from torch import Tensor, nn

from magical.cli import main
from magical.errors import CheckpointError, MissingDependencyError, PluginError, UnknownNameError
from magical.learning import load_policy, train
from magical.learning.algorithms import act, bc
from magical.learning.algorithms.act import ACTConfig
from magical.learning.algorithms.bc import BCConfig
from magical.learning.algorithms.gail import GAILConfig
from magical.learning.encoders import FrameFeatures, FrozenEncoder
from magical.learning.models import PolicyNetwork, Trunk
from magical.learning.networks import find_network, sources_of
from magical.runs import read_metrics
from tests.learning.tiny_runs import checkpoint, same_weights, tiny

MEAN, STD = (0.1, 0.2, 0.3), (0.5, 0.25, 1.0)


class Encoder(nn.Module):
    """A small residual-like network with batch norm, whose features are pooled."""

    def __init__(self, seed: int = 0) -> None:
        super().__init__()
        torch.manual_seed(seed)
        self.layers = nn.Sequential(
            nn.Conv2d(3, 8, 5, 4), nn.BatchNorm2d(8), nn.ReLU(), nn.Conv2d(8, 5, 3, 2)
        )
        self.seen: list[Tensor] = []

    def forward(self, frames: Tensor) -> Tensor:
        self.seen.append(frames)
        features: Tensor = self.layers(frames).mean(dim=(2, 3))
        return features


class FakeTimm(SimpleNamespace):
    """What is used of timm, with one model of any size and one of a fixed size."""

    __version__ = "1.0"
    MODELS: ClassVar = {"tiny.tag": False, "vit.tag": True}  # and whether the size is fixed

    def is_model(self, name: str) -> bool:
        return name.partition(".")[0] in ("tiny", "vit")

    def list_models(self, pattern: str, pretrained: bool) -> list[str]:
        assert pretrained
        return [name for name in self.MODELS if name.startswith(pattern.rstrip("*"))]

    def get_pretrained_cfg(self, name: str) -> Any:
        if name not in self.MODELS:
            raise RuntimeError("Invalid pretrained tag")
        return SimpleNamespace(
            mean=MEAN, std=STD, input_size=(3, 32, 32), fixed_input_size=self.MODELS[name]
        )

    def create_model(self, name: str, pretrained: bool, num_classes: int) -> nn.Module:
        assert (pretrained, num_classes) == (True, 0)
        return Encoder()


@pytest.fixture
def timm(monkeypatch: pytest.MonkeyPatch) -> FakeTimm:
    fake = FakeTimm()
    monkeypatch.setitem(sys.modules, "timm", fake)
    return fake


def features_of(settings: FrozenEncoder, batch_norm: bool = False) -> tuple[FrameFeatures, Encoder]:
    module = settings.make_convolutions(6, batch_norm)
    (encoder,) = module._encoder
    assert isinstance(encoder, Encoder)
    encoder.seen.clear()
    return module, encoder


def test_every_frame_is_encoded_by_itself_and_normalised() -> None:
    module, encoder = features_of(FrozenEncoder(Encoder, MEAN, STD))
    images = torch.rand(4, 6, 40, 40)
    found = module(images)
    plain = Encoder().eval()
    frames = [(images[:, k : k + 3] - torch.tensor(MEAN)[:, None, None]) for k in (0, 3)]
    expected = [plain(frame / torch.tensor(STD)[:, None, None]) for frame in frames]
    assert torch.allclose(found, torch.cat(expected, dim=1), atol=1e-6)
    assert encoder.seen[0].shape == (8, 3, 40, 40)


def test_frames_are_resized_to_what_the_encoder_takes() -> None:
    module, encoder = features_of(FrozenEncoder(Encoder, MEAN, (1.0, 1.0, 1.0), size=32))
    levels = torch.rand(2, 6)
    module(levels[:, :, None, None].expand(2, 6, 96, 96))
    module(torch.zeros(2, 6, 96, 96, dtype=torch.bfloat16))
    frames, from_bfloat16 = encoder.seen
    assert from_bfloat16.shape == frames.shape == (4, 3, 32, 32)
    expected = levels.view(4, 3) - torch.tensor(MEAN)
    assert torch.allclose(frames, expected[:, :, None, None].expand_as(frames), atol=1e-5)


def test_features_are_standardised_each_by_itself() -> None:
    module, _ = features_of(FrozenEncoder(Encoder), batch_norm=True)
    found = module(torch.rand(64, 6, 40, 40)).view(64, 2, 5)
    assert torch.allclose(found.mean(dim=(0, 1)), torch.zeros(5), atol=1e-5)
    assert torch.allclose(found.var(dim=(0, 1)), torch.ones(5), atol=0.05)


class Maps(nn.Module):
    """Features with places."""

    def forward(self, frames: Tensor) -> Tensor:
        return frames[:, :2, ::4, ::4]


def test_features_may_have_places() -> None:
    trunk = Trunk(__name__ + ":MAPS", (6, 96, 96), batch_norm=True)
    linear = trunk.linear[0]
    assert isinstance(linear, nn.Linear)
    assert linear.in_features == 2 * 2 * 24 * 24
    assert trunk(torch.rand(3, 6, 96, 96)).shape == (3, 256)


def test_features_without_places_are_one_position_to_act() -> None:
    network = f"{__name__}:ENCODER"
    config = ACTConfig.preset("quick", tasks=("MoveToRegion",), demos="", network=network)
    made = act.make_policy(config)
    assert len(made.positions) == 1
    images, tasks = torch.rand(2, config.input_shape[0], 96, 96), torch.zeros(2, dtype=torch.long)
    assert made(images, tasks).shape == (2, 16, 18)


ENCODER = FrozenEncoder(Encoder)
MAPS = FrozenEncoder(Maps)


def test_images_stay_in_the_unit_range() -> None:
    trunk = Trunk(__name__ + ":ENCODER", (6, 96, 96), pixel_range="symmetric")
    images = torch.rand(2, 6, 96, 96)
    assert torch.equal(trunk.to_range(images), images)


def test_the_encoder_is_neither_trained_nor_saved_and_stays_as_it_is(
    timm: FakeTimm, demos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[PolicyNetwork] = []
    original = bc.make_policy

    def spy(config: BCConfig) -> PolicyNetwork:
        made.append(original(config))
        return made[-1]

    monkeypatch.setattr(bc, "make_policy", spy)
    config = tiny(BCConfig, demos=str(demos), network="timm:tiny.tag")
    assert train(config, tmp_path).finished
    features = made[0].trunk.convolutions
    assert isinstance(features, FrameFeatures)
    (encoder,) = features._encoder
    for name, tensor in Encoder().state_dict().items():
        assert torch.equal(encoder.state_dict()[name], tensor), name
    assert not encoder.training
    assert not any(parameter.requires_grad for parameter in encoder.parameters())
    saved = checkpoint(tmp_path)["policy"]
    assert {name for name in saved if "convolutions" in name} == {
        "trunk.convolutions.digest",
        *(
            f"trunk.convolutions.norm.{name}"
            for name in ("running_mean", "running_var", "num_batches_tracked")
        ),
    }
    assert not torch.equal(saved["trunk.convolutions.norm.running_mean"], torch.zeros(5))


def test_it_is_resumed_bit_equal_evaluated_and_declared(
    timm: FakeTimm, demos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole, run = tmp_path / "whole", tmp_path / "run"
    options = ["--task", "MoveToRegion", "--demos", str(demos), "--num-demos", "2"]
    size = ["--batches", "4", "--batch-size", "4", "--threads", "1", "--average-decay", "0.5"]
    command = ["train", "bc", *options, *size, "--network", "timm:vit.tag"]
    assert main([*command, "--out", str(whole)]) == 0
    assert main([*command, "--out", str(run), "--stop-after", "2"]) == 0
    assert main(["train", "bc", "--out", str(run), "--resume"]) == 0
    assert same_weights(whole, run)
    rollouts = ["--task", "MoveToRegion", "--variants", "Demo", "--rollouts", "1", "--workers", "0"]
    assert main(["evaluate", str(run), *rollouts, "--out", str(tmp_path / "scores")]) == 0
    entry = json.loads((tmp_path / "scores" / "entry.json").read_text())
    assert entry["details"]["learned_from"] == ["demonstrations", "extra data"]


def test_another_encoder_is_refused(
    timm: FakeTimm, demos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = tiny(BCConfig, demos=str(demos), network="timm:tiny.tag")
    train(config, tmp_path)
    assert load_policy(tmp_path).tasks == ("MoveToRegion",)
    monkeypatch.setattr(timm, "create_model", lambda *args, **kwargs: Encoder(seed=1))
    with pytest.raises(CheckpointError, match=r"another encoder: expected weights with the SHA"):
        load_policy(tmp_path)
    monkeypatch.delitem(sys.modules, "timm")
    with pytest.raises(MissingDependencyError, match=r"network timm:tiny.tag: .* pip install timm"):
        load_policy(tmp_path)


def test_other_learners_take_it_too(timm: FakeTimm, demos: Path, tmp_path: Path) -> None:
    config = tiny(GAILConfig, demos=str(demos), network="timm:tiny.tag", total_steps=12)
    assert config.learned_from == ("demonstrations", "extra data", "interaction")
    assert train(config, tmp_path).finished
    assert len(read_metrics(tmp_path)) == 2


@pytest.mark.parametrize(("name", "size"), [("tiny.tag", None), ("vit.tag", 32)])
def test_frames_are_resized_for_a_model_of_a_fixed_size(
    timm: FakeTimm, name: str, size: int | None
) -> None:
    found = find_network(f"timm:{name}")
    assert isinstance(found, FrozenEncoder)
    assert (found.mean, found.std, found.size) == (MEAN, STD, size)


def test_which_networks_are_pretrained(timm: FakeTimm) -> None:
    assert sources_of("timm:tiny.tag") == ("extra data",)
    assert sources_of(__name__ + ":ENCODER") == ("extra data",)
    assert sources_of("light") == ()


@pytest.mark.parametrize("name", ["huge", "tiny.other", "hf_hub:somebody/model"])
def test_an_unknown_model(timm: FakeTimm, name: str) -> None:
    expected = "such as tiny.tag" if name.startswith("tiny") else "list_models"
    with pytest.raises(UnknownNameError, match=f"timm 1.0 has no such model .*{expected}"):
        find_network(f"timm:{name}")


def test_weights_that_cannot_be_loaded(timm: FakeTimm, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*args: Any, **kwargs: Any) -> None:
        raise OSError("no connection")

    monkeypatch.setattr(timm, "create_model", fail)
    with pytest.raises(PluginError, match=r"timm:tiny.tag.*no connection; with internet access"):
        find_network("timm:tiny.tag").make_convolutions(12, True)


def test_a_missing_library(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "timm", None)
    with pytest.raises(MissingDependencyError, match=r"needs timm.*: pip install timm$"):
        find_network("timm:resnet18")


def test_it_follows_to_another_type(timm: FakeTimm) -> None:
    """`to` reaches the encoder, which is no submodule."""
    module, encoder = features_of(FrozenEncoder(Encoder))
    module.to(torch.float64)
    assert {p.dtype for p in encoder.parameters()} == {torch.float64}
