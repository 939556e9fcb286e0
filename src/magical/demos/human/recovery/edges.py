"""Evidence about the edges of polygons, from the pixels of a recorded frame.

Every pixel centre lies inside or outside every polygon. Given approximate poses and a pixel's
recorded colour, `EdgeFinder` finds the layer that most plausibly gave the colour: the pixel's
centre must lie inside this layer's polygon and outside all polygons in front of it. Each such
statement about a nearby edge is one row of `Edges`: by how much the poses satisfy it, and how that
changes with the bodies' poses.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from magical.demos.human.recovery.edge_search import (
    ANCHOR,
    MAX_LAYERS,
    MIXED,
    TURN,
    FramePlacement,
    Labels,
    Layers,
    Near,
    compiled_search,
)
from magical.errors import RenderError
from magical.render.display import DisplayList, display_list
from magical.render.kernel import FURTHEST, ROBOT_HEIGHT, Floats
from magical.render.palette import OUTSIDE, WHITE, lanes
from magical.scene.constants import RAW_FRAME_SIZE as SIZE
from magical.scene.poses import FIRST_BLOCK
from magical.scene.scene import Scene
from magical.scene.vocabulary import View


class Edges(NamedTuple):
    """N statements about edges near pixel centres.

    `margin` is the distance of a pixel's centre from an edge, positive if the poses satisfy the
    statement. The arrays after it hold its derivatives, in pixels per unit or radian.
    """

    anchor: NDArray[np.int64]  # (N,): row of the body that the polygon moves with; -1: the ground
    turn: NDArray[np.int64]  # (N,): row of the body that it turns with; -1: the ground
    margin: NDArray[np.float64]  # (N,): pixels
    x: NDArray[np.float64]  # (N,): with respect to the anchor's x, or to minus the camera's
    y: NDArray[np.float64]  # (N,): the same for y
    anchor_angle: NDArray[np.float64]  # (N,)
    turn_angle: NDArray[np.float64]  # (N,): 0 if the polygon turns with its anchor
    camera_angle: NDArray[np.float64]  # (N,): by the camera's angle; 0 in allocentric frames


class EdgeFinder:
    """Finds edges in recorded frames of one scene and view, with one sample per pixel.

    Args:
        scene: the scene's bodies and regions; only the regions' poses are used.
        view: the view of the frames.
    """

    def __init__(self, scene: Scene, view: View) -> None:
        self._is_ego = view == View.EGO
        self._bodies = FIRST_BLOCK + len(scene.blocks)
        self._palette, self._layers = _layers(display_list(scene))

    def label(self, frame: NDArray[np.uint8]) -> Labels:
        """Label every pixel with its colour.

        Args:
            frame: (384, 384, 3).

        Returns:
            (384, 384) uint8, lowest row first: numbers of the scene's colours, and
            `edge_search.MIXED` for any other colour, such as in antialiased lines.

        Raises:
            RenderError: the frame has another shape.
        """
        if frame.shape != (SIZE, SIZE, 3):
            raise RenderError(f"expected a frame {SIZE} across, found {frame.shape}")
        packed = frame[::-1].astype(np.int32) @ np.array([1, 1 << 8, 1 << 16], np.int32)
        numbers = np.searchsorted(self._palette, packed)
        known = self._palette.take(numbers, mode="clip") == packed
        return np.where(known, numbers, MIXED).astype(np.uint8)

    def find(
        self, bodies: NDArray[np.float64], labels: Labels, band: float, wanted: NDArray[np.bool_]
    ) -> Edges:
        """All statements about edges within `band` pixels of pixel centres.

        Args:
            bodies: (5 + blocks, 3), the poses in the rows of `Poses`.
            labels: a frame's labels, from `label`.
            band: largest distance in pixels.
            wanted: (5 + blocks,), true for the bodies whose edges matter.

        Raises:
            RenderError: the poses are not one for each body, or not finite and within `FURTHEST`.
        """
        if bodies.shape != (self._bodies, 3) or not np.abs(bodies).max() <= FURTHEST:
            raise RenderError(f"expected {self._bodies} finite poses within {FURTHEST:g} units")
        near, numbers, margins = _working_memory()
        placement = FramePlacement(
            frames=np.empty((len(bodies) + 1, 4)),
            planes=np.empty((3, self._layers.vertices.shape[1])),
            origins=np.empty((len(self._layers.items), 2)),
            circles=np.empty_like(self._layers.circles),
            to_workspace=np.empty(4),
            ego=self._is_ego,
        )
        count = compiled_search()(
            bodies, self._layers, labels, near, placement, wanted, band, numbers, margins
        )
        return self._edges(numbers[:, :count], margins[:count].copy(), placement)

    def _edges(
        self, numbers: NDArray[np.int32], margins: Floats, placement: FramePlacement
    ) -> Edges:
        """The statements found by `edge_search.compiled_search`, with their derivatives."""
        item, edge, pixel, sign = numbers
        frames, planes, origins = placement.frames, placement.planes, placement.origins
        x, y = pixel % SIZE + 0.5, pixel // SIZE + 0.5
        ground, workspace = item < 0, frames[-1]
        nx, ny = planes[0, edge], planes[1, edge]
        nx[ground], ny[ground] = self._ground_normals(
            -1 - item[ground], x[ground], y[ground], workspace
        )
        nx, ny = sign * nx, sign * ny
        polygon = np.where(ground, 0, item)
        anchor = np.where(ground, -1, self._layers.items[polygon, ANCHOR])
        turn = np.where(ground, -1, self._layers.items[polygon, TURN])
        own_x, own_y = np.where(anchor == turn, (x, y), origins[polygon].T)
        anchor_x, anchor_y = frames[anchor, 2:].T
        camera = np.zeros_like(margins)
        if self._is_ego:
            camera = nx * (y - SIZE * ROBOT_HEIGHT) - ny * (x - SIZE / 2)
        return Edges(
            anchor=anchor,
            turn=turn,
            margin=margins,
            x=nx * workspace[0] + ny * workspace[1],
            y=ny * workspace[0] - nx * workspace[1],
            anchor_angle=ny * (own_x - anchor_x) - nx * (own_y - anchor_y),
            turn_angle=ny * (x - own_x) - nx * (y - own_y),
            camera_angle=camera,
        )

    def _ground_normals(
        self, rectangle: NDArray[np.int32], x: Floats, y: Floats, workspace: Floats
    ) -> tuple[Floats, Floats]:
        """The outward normals, on the frame, of the rectangle edges nearest to the points."""
        cos, sin, x0, y0 = workspace
        square, dx, dy = cos * cos + sin * sin, x - x0, y - y0
        u, v = (cos * dx + sin * dy) / square, (cos * dy - sin * dx) / square
        left, right, bottom, top = self._layers.rectangles[rectangle].T
        nearest = np.argmin([u - left, right - u, v - bottom, top - v], axis=0)
        outward = np.array([(-1.0, 0.0), (1.0, 0.0), (0.0, -1.0), (0.0, 1.0)])[nearest]
        nx, ny = outward.T / np.sqrt(square)
        return cos * nx - sin * ny, sin * nx + cos * ny


def _layers(shown: DisplayList) -> tuple[NDArray[np.int32], Layers]:
    """The packed colours in a scene, in ascending order, and its layers."""
    count, regions = len(shown.items), shown.colours[:0:-1].ravel()  # uppermost first
    colours = np.concatenate([shown.items[:, 4], regions, [lanes(WHITE), lanes(OUTSIDE)]])
    packed = colours & 0xFF | colours >> 8 & 0xFF00 | colours >> 16 & 0xFF0000
    palette, numbers = np.unique(packed, return_inverse=True)
    items = np.column_stack([shown.items[:, :4], numbers[:count], _parts(shown)])
    shades = [*numbers[count:-2].reshape(-1, 2), *((number, -1) for number in numbers[-2:])]
    corners = np.concatenate([shown.ground[:0:-1], shown.ground[:1]])
    low, high = corners.min(axis=1), corners.max(axis=1)
    rectangles = np.stack([low[:, 0], high[:, 0], low[:, 1], high[:, 1]], axis=1)
    circles = np.array([_circles(shown.vertices[:, a : a + n]) for a, n in items[:, :2]])
    return palette.astype(np.int32), Layers(
        shown.vertices, items, shown.offsets, circles, rectangles, np.array(shades, np.int64)
    )


def _parts(shown: DisplayList) -> NDArray[np.int64]:
    """Part numbers: successive polygons of one colour in one place form one shape."""
    keys = np.concatenate([shown.items[:, 2:], shown.offsets], axis=1)
    return np.cumsum([0, *(keys[1:] != keys[:-1]).any(axis=1)])


def _circles(points: Floats) -> tuple[float, float, float, float]:
    """A polygon's centre, and the radii of the inner and outer circles about it."""
    centre = points.mean(axis=1, keepdims=True)
    dx, dy = np.roll(points, -1, axis=1) - points
    x, y = centre - points
    inner = float(((dx * y - dy * x) / np.hypot(dx, dy)).min())
    return float(centre[0, 0]), float(centre[1, 0]), inner, float(np.hypot(x, y).max())


@cache
def _working_memory() -> tuple[Near, NDArray[np.int32], Floats]:
    """Scratch and result arrays of `edge_search.compiled_search`."""
    pixels, rows = SIZE * SIZE, 4 * SIZE * SIZE
    near = Near(
        counts=np.zeros(pixels, np.int8),
        wanted=np.zeros(pixels, np.bool_),
        item=np.empty((pixels, MAX_LAYERS), np.int16),
        edge=np.empty((pixels, MAX_LAYERS), np.int16),
        inside=np.empty((pixels, MAX_LAYERS), np.float32),
    )
    return near, np.empty((4, rows), np.int32), np.empty(rows)
