"""Following all bodies through a recording, frame by frame."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from magical.demos.human.recovery.fit import COARSE, FINE, MIDDLE, Bodies, PoseFitter
from magical.physics import Simulation
from magical.render import Renderer
from magical.scene import Poses, Scene, Shape, View
from magical.scene.constants import CONTROL_RATE, RAW_FRAME_SIZE
from magical.scene.poses import EYES, FIRST_BLOCK, ROBOT

Image = NDArray[np.uint8]
TOLERANCE = 8  # grey levels: pixels that differ by more are wrong


class Tracker:
    """Recovers the poses of one episode.

    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._fitter = PoseFitter(scene)
        self._renderers = {view: Renderer(scene, view, RAW_FRAME_SIZE, 1, False) for view in View}
        self._rendered = {
            view: np.empty((RAW_FRAME_SIZE, RAW_FRAME_SIZE, 3), np.uint8) for view in View
        }
        self._simulation = Simulation(scene)
        self.bodies = Poses.at_rest(scene).bodies
        self.state = self._simulation.read().copy()
        self.size=RAW_FRAME_SIZE

    def wrong(self, bodies: Bodies, frames: Mapping[View, Image]) -> dict[View, NDArray[np.bool_]]:
        result = {}
        for view, renderer in self._renderers.items():
            renderer.render(bodies, self._rendered[view])
            a, b = self._rendered[view], frames[view]
            result[view] = (np.maximum(a, b) - np.minimum(a, b) > TOLERANCE).any(axis=2)
        return result

    def count(self, bodies, frames):
        return sum(int(w.sum()) for w in self.wrong(bodies, frames).values())

    def predict(self, action: int) -> Bodies:
        self._simulation.write(self.state)
        self._simulation.step(action)
        self.state = self._simulation.read().copy()
        return self.state[:, :3].copy()

    def step(self, action: int, frames: Mapping[View, Image]):
        previous = self.bodies
        guess = self.predict(action)
        labels = self._fitter.label(frames)
        mixed = guess.copy()
        mixed[FIRST_BLOCK:] = previous[FIRST_BLOCK:]
        wrong = self.wrong(mixed, frames)
        free = [*range(FIRST_BLOCK), *self._moved(previous, guess, wrong[View.ALLO])]
        start = mixed
        for row in free:
            start[row] = guess[row]
        fit = self._fitter.fit(start, labels, free, MIDDLE + FINE)
        count = self.count(fit.bodies, frames)
        self.retries = 0
        if count > 300:
            for other in (start, previous):
                self.retries += 1
                again = self._fitter.fit(other, labels, range(len(previous)), COARSE + MIDDLE + FINE)
                c = self.count(again.bodies, frames)
                if c < count:
                    fit, count = again, c
        bodies = fit.bodies
        for row in range(FIRST_BLOCK, len(bodies)):
            if (abs(bodies[row] - previous[row]) < 3 * fit.deviations[row]+1e-9).all():
                bodies[row] = previous[row]
        self.correct(guess, bodies, previous)
        return fit, len(free) - FIRST_BLOCK

    def correct(self, guess, bodies, previous):
        self.bodies = bodies
        self.state[:, 3:] += CONTROL_RATE * (bodies - guess)
        self.state[:, :3] = bodies
        still = (bodies == previous).all(axis=1)
        self.state[still, 3:] = 0.0

    def _moved(self, previous, guess, wrong):
        rows, cols = np.nonzero(wrong)
        x = (cols + 0.5) * 2.04 / self.size - 1.02
        y = 1.02 - (rows + 0.5) * 2.04 / self.size
        found = []
        for row in range(FIRST_BLOCK, len(previous)):
            d = np.hypot(x - previous[row, 0], y - previous[row, 1])
            if (d < 0.16 + 0.02).any():
                found.append(row)
        return found
