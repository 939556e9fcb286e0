"""`render_mode="human"`, without a screen."""

import sys

import gymnasium
import numpy as np
import pytest

from magical.errors import MissingDependencyError

ID = "magical/MoveToCorner-Demo-v0"


def test_each_frame_is_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    pygame = pytest.importorskip("pygame")
    env = gymnasium.make(ID, render_mode="human", horizon=3)
    pictures = gymnasium.make(ID, render_mode="rgb_array", horizon=3)
    for one in (env, pictures):
        one.reset(seed=0)
        one.step(5)
    shown = pygame.surfarray.array3d(pygame.display.get_surface()).swapaxes(0, 1)
    frame = pictures.render()
    np.testing.assert_array_equal(shown, np.asarray(frame))
    env.close()
    assert pygame.display.get_surface() is None


def test_without_pygame_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(MissingDependencyError, match=r"pip install .*pygame-ce.* 'window'"):
        gymnasium.make(ID, render_mode="human")
