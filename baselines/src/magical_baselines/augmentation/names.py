"""Names of image augmentations, and the paper's ablations of them (no PyTorch)."""

from dataclasses import dataclass, replace
from typing import Any

from magical.errors import UnknownNameError


@dataclass(frozen=True, slots=True)
class Augmentations:
    """Which augmentations are switched on, and how they are computed."""

    noise: bool = True
    translation: bool = True
    rotation: bool = True
    colour: bool = True
    borders: str = "mirror"  # beyond the image: "mirror" it, or "repeat" its outermost pixels
    linear_light: bool = True  # decode sRGB before the conversion to CIE Lab


NAMES = ("noise", "translation", "rotation", "colour")
SETS = {
    "all": Augmentations(),
    "no-trans-rot": Augmentations(translation=False, rotation=False),
    "none": Augmentations(False, False, False, False),
}


def parse_augmentations(text: str) -> Augmentations:
    """Parse one of `SETS`, or names joined by `+`, such as `noise+rotation`.

    `no-trans-rot` and `none` are "no trans./rot. aug." and "no aug." in the paper's tables. Raises
    `UnknownNameError`.
    """
    if text in SETS:
        return SETS[text]
    chosen = text.split("+")
    unknown = [name for name in chosen if name not in NAMES]
    if unknown:
        raise UnknownNameError(
            f"augmentation {unknown[0]!r} is unknown; expected one of {', '.join(SETS)}, or some "
            f"of {', '.join(NAMES)} joined by +"
        )
    switches: dict[str, Any] = dict.fromkeys(chosen, True)
    return replace(SETS["none"], **switches)
