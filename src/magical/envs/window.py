"""The window of `render_mode="human"`; needs pygame, from the extra `window`."""

import numpy as np
from numpy.typing import NDArray

from magical.extras import require


class Window:
    """Shows frames at a fixed rate; it opens with the first one."""

    def __init__(self, title: str, rate: int) -> None:
        """Raise `MissingDependencyError` without pygame.

        Args:
            title: of the window.
            rate: maximum frames per second; `show` waits to keep to it.
        """
        require("window")
        import pygame

        self._pygame, self._title, self._rate = pygame, title, rate
        self._clock = pygame.time.Clock()
        self._surface: pygame.Surface | None = None

    def show(self, frame: NDArray[np.uint8]) -> None:
        """Show an RGB frame (H, W, 3)."""
        pygame = self._pygame
        # Closing any window ends pygame's display.
        if self._surface is None or not pygame.display.get_init():
            pygame.display.init()
            self._surface = pygame.display.set_mode((frame.shape[1], frame.shape[0]))
            pygame.display.set_caption(self._title)
        pygame.event.pump()  # otherwise the system considers the window unresponsive
        pygame.surfarray.blit_array(self._surface, frame.swapaxes(0, 1))
        pygame.display.flip()
        self._clock.tick(self._rate)

    def close(self) -> None:
        """Close the window; a later `show` opens another."""
        if self._surface is not None:
            self._pygame.display.quit()
            self._surface = None
