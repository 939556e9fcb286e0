"""Software rendering of scenes into numpy arrays (docs/specification.md, section 6)."""

from magical.render.renderer import Renderer, render_frame, render_views, shift_stack, warm_up
from magical.scene import default_samples

__all__ = [
    "Renderer",
    "default_samples",
    "render_frame",
    "render_views",
    "shift_stack",
    "warm_up",
]
