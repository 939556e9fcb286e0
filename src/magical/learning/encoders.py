"""Frozen, pre-trained image encoders as network architectures.

An encoder processes each frame of a stack separately. Only the linear layers on its features are
trained here. Checkpoints hold a digest of the encoder's weights instead of the weights.
"""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, Self

import torch
from torch import Tensor, nn
from torch.nn import functional

from magical.errors import CheckpointError, PluginError, UnknownNameError
from magical.extras import library
from magical.observe.pixels import CHANNELS
from magical.scene.constants import FRAME_SIZE

RGB = tuple[float, float, float]

# Channel statistics of ImageNet's images, in [0, 1]: what most encoders expect.
MEAN: RGB = (0.485, 0.456, 0.406)
STD: RGB = (0.229, 0.224, 0.225)


@dataclass(frozen=True, slots=True)
class FrozenEncoder:
    """A network architecture: an encoder of single frames, and linear layers on its features.

    Attributes:
        load: returns the encoder with its weights, a module from frames (B, 3, H, W) to features
            (B, F, ...).
        mean: the mean of each channel over the images that it was trained on, in [0, 1].
        std: the standard deviation of each channel.
        size: the height and width that frames are resized to; `None`: they are not resized.
        HIDDEN: the sizes of the linear layers.
    """

    load: Callable[[], nn.Module]
    mean: RGB = MEAN
    std: RGB = STD
    size: int | None = None
    HIDDEN: tuple[int, ...] = (256,)

    PIXEL_RANGE: ClassVar[str] = "unit"
    PRETRAINED: ClassVar[bool] = True

    def make_convolutions(self, channels: int, batch_norm: bool) -> "FrameFeatures":
        """See `magical.learning.networks`; batch norm applies to the features."""
        return FrameFeatures(self, batch_norm)


class FrameFeatures(nn.Module):
    """Maps images (B, channels, H, W) in [0, 1] to features of each frame, (B, frames * F * ...).

    The encoder is not a submodule: it has nothing to train or save, and stays in evaluation mode.
    The features of nearly white frames differ little, unless batch norm standardises each feature.
    """

    digest: Tensor
    mean: Tensor
    std: Tensor

    def __init__(self, settings: FrozenEncoder, batch_norm: bool) -> None:
        super().__init__()
        encoder = settings.load().eval().requires_grad_(False)
        self._encoder = (encoder,)
        self._size = settings.size
        self.register_buffer("digest", _digest(encoder))
        for name in ("mean", "std"):
            values = torch.tensor(getattr(settings, name)).view(-1, 1, 1)
            self.register_buffer(name, values, persistent=False)
        size = settings.size or FRAME_SIZE
        with torch.no_grad():
            num_features = encoder(torch.zeros(1, CHANNELS, size, size)).shape[1]
        self.norm = nn.BatchNorm1d(num_features, affine=False) if batch_norm else nn.Identity()

    def forward(self, images: Tensor) -> Tensor:
        """Return the features."""
        (encoder,) = self._encoder
        # Float32: no resizing on CPUs in bfloat16.
        frames = images.float().reshape(-1, CHANNELS, *images.shape[2:])  # (B * frames, 3, H, W)
        if self._size is not None and frames.shape[2:] != (self._size, self._size):
            frames = functional.interpolate(frames, self._size, mode="bicubic", antialias=True)
        features = encoder((frames - self.mean) / self.std)  # (B * frames, F, ...)
        features = self.norm(features.reshape(*features.shape[:2], -1))
        flat: Tensor = features.reshape(len(images), -1)
        return flat

    def _apply(self, fn: Any, recurse: bool = True) -> Self:
        """Apply the function to the encoder too; this method is untyped in PyTorch."""
        self._encoder[0]._apply(fn)  # type: ignore[no-untyped-call]
        super()._apply(fn, recurse)  # type: ignore[no-untyped-call]
        return self

    def _load_from_state_dict(self, state_dict: Any, prefix: str, *rest: Any) -> None:
        """Reject weights that were trained on another encoder's features."""
        saved = state_dict.get(f"{prefix}digest")
        if saved is not None and not torch.equal(saved.cpu(), self.digest.cpu()):
            found, expected = (bytes(d.tolist()).hex()[:12] for d in (self.digest, saved))
            raise CheckpointError(
                "network: the run was trained on the features of another encoder: expected weights "
                f"with the SHA-256 digest {expected}..., found {found}...; load the original ones"
            )
        super()._load_from_state_dict(state_dict, prefix, *rest)


def _digest(module: nn.Module) -> Tensor:
    """The SHA-256 digest of all weights: (32,) uint8."""
    digest = hashlib.sha256()
    for name, tensor in module.state_dict().items():
        digest.update(name.encode())
        digest.update(tensor.cpu().contiguous().reshape(-1).view(torch.uint8).numpy().tobytes())
    return torch.tensor(list(digest.digest()), dtype=torch.uint8)


def timm_encoder(name: str) -> FrozenEncoder:
    """An encoder from PyTorch Image Models (timm) with its pre-trained weights.

    Its output is pooled. Frames are resized only if the model has a fixed input size.

    Raises:
        MissingDependencyError: timm is not installed.
        UnknownNameError: timm has no such model with pre-trained weights.
    """
    timm = library("timm", f"network timm:{name}")
    try:
        config = timm.get_pretrained_cfg(name) if timm.is_model(name) else None
    except RuntimeError:  # a tag that the model does not have
        config = None
    if config is None:
        family = name.partition(".")[0]
        known = ", ".join(timm.list_models(f"{family}*", pretrained=True)[:8])
        raise UnknownNameError(
            f"network timm:{name}: timm {timm.__version__} has no such model with weights; "
            f"choose one{f', such as {known}' if known else ''}: timm.list_models(pretrained=True)"
        )
    size = config.input_size[-1] if config.fixed_input_size else None
    return FrozenEncoder(
        partial(_load_timm, timm, name), tuple(config.mean), tuple(config.std), size
    )


def _load_timm(timm: Any, name: str) -> nn.Module:
    try:
        model: nn.Module = timm.create_model(name, pretrained=True, num_classes=0)
    except (OSError, RuntimeError) as error:
        raise PluginError(
            f"network timm:{name}: its weights cannot be loaded: {error}; with internet "
            f"access, timm.create_model({name!r}, pretrained=True) adds them to its cache"
        ) from error
    return model
