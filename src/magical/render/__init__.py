"""Software drawing of scenes into numpy arrays (docs/specification.md, section 6)."""

from magical.render.output import shift_stack
from magical.render.renderer import Renderer, default_samples, draw_both, draw_frame, warm_up

__all__ = [
    "Renderer",
    "default_samples",
    "draw_both",
    "draw_frame",
    "shift_stack",
    "warm_up",
]
