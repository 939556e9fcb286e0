"""An observation: the newest two egocentric frames instead of four."""

from magical.observe import PixelSpec
from magical.scene import View

TWO_FRAMES = PixelSpec(((View.EGO, 2),))
