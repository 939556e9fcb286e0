"""Which augmentations are applied to images: names, the paper's ablations, parsing (no PyTorch)."""

from dataclasses import dataclass, fields

from magical.errors import UnknownNameError


@dataclass(frozen=True, slots=True)
class Augmentations:
    """Which augmentations are switched on."""

    noise: bool = True
    translation: bool = True
    rotation: bool = True
    colour: bool = True


NAMES = tuple(field.name for field in fields(Augmentations))
SETS = {
    "all": Augmentations(),
    "no-trans-rot": Augmentations(translation=False, rotation=False),
    "none": Augmentations(False, False, False, False),
}


def parse_augmentations(text: str) -> Augmentations:
    """Parse one of `SETS`, or names joined by `+`, such as `noise+rotation`.

    `no-trans-rot` and `none` are the tables' "no trans./rot. aug." and "no aug.".

    Raises:
        UnknownNameError: a name that is none of these.
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
    return Augmentations(**{name: name in chosen for name in NAMES})
