"""The 8-bit colours of everything rendered (docs/specification.md, section 6)."""

from typing import NamedTuple

from magical.scene import Colour

RGB = tuple[int, int, int]


class Shades(NamedTuple):
    """The shades of one colour word: a block's fill and outline, a goal region's fill.

    A region's dashes use `fill`.
    """

    fill: RGB
    outline: RGB
    region: RGB


SHADES = {
    Colour.RED: Shades((245, 129, 165), (243, 94, 141), (250, 190, 209)),
    Colour.GREEN: Shades((195, 208, 130), (183, 198, 105), (224, 231, 191)),
    Colour.BLUE: Shades((135, 185, 211), (110, 170, 202), (194, 219, 233)),
    Colour.YELLOW: Shades((254, 213, 123), (254, 201, 86), (254, 234, 188)),
}

GREY: RGB = (162, 163, 175)  # robot, fingers, the workspace's edge
GREY_OUTLINE: RGB = (144, 145, 159)
OUTSIDE: RGB = (231, 231, 234)  # around the workspace, and the inside of the fingers
WHITE: RGB = (255, 255, 255)  # the workspace and the eyes
PUPIL: RGB = (26, 26, 26)


def lanes(colour: RGB) -> int:
    """One colour in three 16-bit lanes (red lowest), so that sums of up to 257 colours fit."""
    red, green, blue = colour
    return red | green << 16 | blue << 32
