"""Which block is moved next, and where to: sums of functions of single relations.

A relation is a number: mostly the distance of a block, at a place, to the nearest object of some
kind, such as the nearest other block of the same colour. Absolute colours, shapes, directions and
(unless a block has no other object to relate to) positions do not occur, so whatever is learned
from relations also holds for permuted colours and shapes, and for scenes that are mirrored or
rotated by quarter turns.

Each relation has a piecewise linear function, learned for each task. The logit of a block is the
sum over the relations that it has where it lies; the logit of a destination is the sum over those
that the block would have there. A sum has no order, and each term depends on one kind of object, so
the model carries over to other counts, colours and layouts. Nothing is left to do once no block has
a high score. The model is trained by maximum likelihood of the goals found in hindsight, with a
group lasso: few and simple relations have to explain all demonstrations.
"""

import math
from collections.abc import Callable, Sequence
from functools import cached_property, partial
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from magical.scene import COLOURS, SHAPES
from magical_goals.objects.control import ROBOT_TARGET, ObjectTable

UNKNOWN = 9.0  # the value of a relation to something that does not exist
NO_KIND = -5  # the colour and shape of the robot: equal to no block's

BESIDE = 0.6  # units between the centres of two blocks
LINE_GAP, LINE_OVERLAP = 0.4, 0.2  # units: farthest and nearest neighbours in a line

# Knots of the piecewise linear functions of a relation (see `goals`): a few for the choice of a
# block, more for its destination. Values beyond the last knot are all treated alike, because far
# away only the kind of object should matter; UNKNOWN has its own knot.
EDGE = (
    (-0.12, -0.04, 0.0, 0.05, 0.15),
    (-0.3, -0.25, -0.2, -0.15, -0.1, -0.05, 0.0, 0.03, 0.06, 0.1, 0.15, 0.2, 0.25, 0.3),
)
CONTACT = (
    (0.2, 0.25, 0.3, 0.36, 0.45),
    (0.0, 0.1, 0.15, 0.18, 0.2, 0.22, 0.24, 0.26, 0.28, 0.3, 0.33, 0.36, 0.4, 0.45),
)
GROUP = (
    (0.1, 0.25, 0.4, 0.6, 0.9),
    (0.0, 0.03, 0.06, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.65, 0.8, 1.1, 1.6),
)
LINE = (
    (0.0, 0.06, 0.12, 0.2, 0.3),
    (0.0, 0.02, 0.04, 0.06, 0.08, 0.1, 0.12, 0.14, 0.17, 0.2, 0.23, 0.27, 0.32, 0.4),
)
SHARE = (
    (0.2, 0.3, 0.37, 0.45, 0.6),
    (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5, 0.6, 0.7, 0.8),
)
WALL = (
    (0.1, 0.15, 0.2, 0.28, 0.35),
    (0.0, 0.03, 0.06, 0.09, 0.12, 0.14, 0.16, 0.18, 0.2, 0.22, 0.24, 0.26, 0.3, 0.35),
)
PLACE = (
    (-1.0, -0.5, 0.0, 0.5, 1.0),
    (-1.0, -0.85, -0.7, -0.55, -0.4, -0.25, -0.1, 0.1, 0.25, 0.4, 0.55, 0.7, 0.85, 1.0),
)


class Relation(NamedTuple):
    """How a number is computed, its knots, and its penalties, which are the prior."""

    name: str
    measure: Callable[["_Scene"], Tensor]  # gives (B, K)
    knots: tuple[tuple[float, ...], tuple[float, ...]]
    choice_penalty: float
    destination_penalty: float


class _Scene:
    """A target at K places in each scene, with masks of objects (B, N) or (B, M) and distances."""

    def __init__(self, table: ObjectTable, targets: Tensor, places: Tensor) -> None:
        self.table, self.places = table, places
        rows = torch.arange(table.size, device=targets.device)
        robot = targets == ROBOT_TARGET
        block = targets.clamp(min=0)
        self.colour = table.colours[rows, block].masked_fill(robot, NO_KIND)
        self.shape = table.shapes[rows, block].masked_fill(robot, NO_KIND)
        self.now = torch.where(robot[:, None], table.robot[:, :2], table.blocks[rows, block])
        self.others = table.present.clone()
        self.others[rows, block] &= robot
        self.same_colour = table.colours == self.colour[:, None]
        self.same_shape = table.shapes == self.shape[:, None]
        self.regions = table.region_colours >= 0
        self.same_region = table.region_colours == self.colour[:, None]

    @cached_property
    def to_regions(self) -> Tensor:
        """Distances of the places to the regions' edges, (B, M, K)."""
        return _edge_distances(self.places, self.table.regions)

    def region(self, mask: Tensor) -> Tensor:
        """Distances (B, K) of the places to the nearest region in a mask (B, M)."""
        return _nearest(self.to_regions, mask & self.regions)

    @cached_property
    def to_blocks(self) -> Tensor:
        """Distances of the places to the blocks, (B, N, K)."""
        return _distances(self.table.blocks, self.places)

    @cached_property
    def in_region(self) -> Tensor:
        """Which blocks (B, N) lie in a region."""
        inside = _edge_distances(self.table.blocks, self.table.regions) <= 0.0  # (B, M, N)
        return (inside & self.regions[:, :, None]).any(dim=1)

    @cached_property
    def around(self) -> Tensor:
        """Which regions (B, M) the target is in now, give or take 0.02 units."""
        return _edge_distances(self.now[:, None], self.table.regions)[..., 0] <= 0.02

    @cached_property
    def line_residuals(self) -> tuple[Tensor, Tensor, Tensor]:
        """How far places are from continuing each pair's line, (B, P, K); valid pairs; lengths.

        A place should also be at a neighbour's distance from one of the two blocks.
        """
        blocks = self.table.blocks
        count = blocks.shape[1]
        first, second = torch.triu_indices(count, count, 1, device=blocks.device)
        start, end = blocks[:, first], blocks[:, second]  # (B, P, 2)
        length = (end - start).norm(dim=2).clamp(min=1e-3)
        direction = (end - start) / length[..., None]
        normal = torch.stack([direction[..., 1], -direction[..., 0]], dim=2)
        along, across = (
            axis @ self.places.transpose(1, 2) - (start * axis).sum(dim=2, keepdim=True)
            for axis in (direction, normal)
        )
        gap = torch.minimum(along.abs(), (along - length[..., None]).abs())
        beyond, within = (gap - LINE_GAP).clamp(min=0.0), (LINE_OVERLAP - gap).clamp(min=0.0)
        residual = (across**2 + beyond**2 + 4.0 * within**2).sqrt()
        return residual, self.others[:, first] & self.others[:, second], length


def relate(
    table: ObjectTable, targets: Tensor, places: Tensor, which: Sequence[int] | None = None
) -> Tensor:
    """The relations (B, K, R) that each scene's target (B,) would have at places (B, K, 2).

    `which` has the positions in `RELATIONS` of those to compute; None: all.
    """
    scene = _Scene(table, targets, places)
    chosen = RELATIONS if which is None else [RELATIONS[k] for k in which]
    return torch.stack([relation.measure(scene) for relation in chosen], dim=2)


def _edge_distances(places: Tensor, regions: Tensor) -> Tensor:
    """Distances of places (B, K, 2) to the edges of regions: (B, M, K), negative inside."""
    x, y = (
        (places[:, None, :, axis] - regions[:, :, None, axis]).abs() - regions[:, :, None, 2 + axis]
        for axis in (0, 1)
    )
    return torch.maximum(x, y)


def _distances(objects: Tensor, places: Tensor) -> Tensor:
    """Distances of objects (B, N, 2) to places (B, K, 2): (B, N, K)."""
    return torch.cdist(objects, places, compute_mode="donot_use_mm_for_euclid_dist")


def _nearest(distances: Tensor, mask: Tensor) -> Tensor:
    """The smallest of the distances (B, N, K) to objects in a mask (B, N): (B, K)."""
    return distances.masked_fill(~mask[..., None], UNKNOWN).amin(dim=1)


def _nearest_block(
    scene: _Scene, colour: bool | None, shape: bool | None, in_region: bool | None
) -> Tensor:
    """The distance to the nearest other block; None: with or without that property."""
    mask = scene.others
    for wanted, is_so in ((colour, scene.same_colour), (shape, scene.same_shape)):
        if wanted is not None:
            mask = mask & (is_so == wanted)
    if in_region is not None:
        mask = mask & (scene.in_region == in_region)
    return _nearest(scene.to_blocks, mask)


def _centre_distances(scene: _Scene, masks: Tensor) -> Tensor:
    """Distances (B, G, K) to the mean positions of the blocks of each of G masks (B, G, N)."""
    total = masks.sum(dim=2, keepdim=True)  # (B, G, 1)
    centres = masks.float() @ scene.table.blocks / total.clamp(min=1.0)
    return _distances(centres, scene.places).masked_fill(total == 0, UNKNOWN)


def _line(scene: _Scene, longest: float) -> Tensor:
    """How far places are from continuing a line of two other blocks less than `longest` apart."""
    residual, pairs, length = scene.line_residuals
    return _nearest(residual, pairs & (length < longest))


def _own_centre(scene: _Scene, kind: str) -> Tensor:
    """The distance to the centre of the other blocks of the same colour or shape."""
    same: Tensor = getattr(scene, f"same_{kind}")
    return _centre_distances(scene, (scene.others & same)[:, None])[:, 0]


def _share(scene: _Scene, kind: str) -> Tensor:
    """The distance to the own group's centre, as a share of it plus that to the nearest other."""
    kinds, own = getattr(scene.table, f"{kind}s"), getattr(scene, kind)
    groups = torch.arange(len(COLOURS if kind == "colour" else SHAPES), device=own.device)
    distances = _centre_distances(
        scene, scene.others[:, None] & (kinds[:, None] == groups[:, None])
    )
    mine = groups == own[:, None]  # (B, count)
    to_own, to_other = _nearest(distances, mine), _nearest(distances, ~mine)
    known = (to_own < UNKNOWN) & (to_other < UNKNOWN)
    return (to_own / (to_own + to_other + 1e-6)).masked_fill(~known, UNKNOWN)


def _coordinate(scene: _Scene, axis: int) -> Tensor:
    """A place's coordinate, if there are no regions and no other blocks."""
    alone = ~scene.regions.any(dim=1) & ~scene.others.any(dim=1)
    return scene.places[..., axis].masked_fill(~alone[:, None], UNKNOWN)


def _block_relation(
    name: str, colour: bool | None, shape: bool | None, in_region: bool | None, *penalties: float
) -> Relation:
    measure = partial(_nearest_block, colour=colour, shape=shape, in_region=in_region)
    return Relation(name, measure, CONTACT, *penalties)


RELATIONS = (
    Relation("region of the same colour", lambda s: s.region(s.same_region), EDGE, 1.5, 1.5),
    Relation("region of another colour", lambda s: s.region(~s.same_region), EDGE, 1.5, 1.5),
    Relation("any region", lambda s: s.region(s.regions), EDGE, 1, 1),
    _block_relation("block of the same colour and shape, in a region", True, True, True, 2, 2),
    _block_relation("block of the same colour and shape, in none", True, True, False, 2, 2),
    _block_relation("block of the same colour alone, in a region", True, False, True, 2, 2),
    _block_relation("block of the same colour alone, in none", True, False, False, 2, 2),
    _block_relation("block of the same shape alone, in a region", False, True, True, 2, 2),
    _block_relation("block of the same shape alone, in none", False, True, False, 2, 2),
    _block_relation("block of another colour and shape, in a region", False, False, True, 8, 4),
    _block_relation("block of another colour and shape, in none", False, False, False, 8, 4),
    Relation("centre of others of its colour", partial(_own_centre, kind="colour"), GROUP, 4, 2),
    Relation("centre of others of its shape", partial(_own_centre, kind="shape"), GROUP, 4, 2),
    _block_relation("block of another colour", False, None, None, 8, 4),
    _block_relation("block of another shape", None, False, None, 8, 4),
    _block_relation("any other block", None, None, None, 8, 2),
    Relation("line of two other blocks", partial(_line, longest=math.inf), LINE, 4, 3),
    Relation("line of two other blocks side by side", partial(_line, longest=BESIDE), LINE, 8, 2),
    Relation("share of the own colour's distance", partial(_share, kind="colour"), SHARE, 4, 2),
    Relation("share of the own shape's distance", partial(_share, kind="shape"), SHARE, 4, 2),
    Relation("wall", lambda s: 1.0 - s.places.abs().amax(dim=2), WALL, 8, 2),
    Relation("x, where there is nothing else", partial(_coordinate, axis=0), PLACE, 1, 1),
    Relation("y, where there is nothing else", partial(_coordinate, axis=1), PLACE, 1, 1),
    Relation("region that it is in now", lambda s: s.region(s.around), EDGE, 1, 1),
)

GRIP_KNOTS = (0.04, 0.08, 0.14, 0.22, 0.32)  # units from the point between the fingers
GRIP_PENALTY = 0.5
NEARNESS = 1.0  # logits lost per unit from fingers to block, from block to place: breaks ties
TINY = 1e-4  # added to a squared norm, which keeps the norm differentiable at 0
CANDIDATES = 64  # random places per destination in training: the negatives
BORDER = 0.95  # units: the cells of destinations are within [-BORDER, BORDER]
CELLS = 16  # of the grid of destinations, along each axis
STEPS = 2  # finer places on either side of the best cell's centre
IMPOSSIBLE = -1e9
SURE = 0.8  # probability of being done at which to stop: too late costs less than too early
LARGE = 30.0  # logits: if there is no block, the highest score counts as -LARGE
DESTINATION = 2.0  # sparsity of the destinations' functions, relative to the others
LEFT_OUT = 0.25  # norm of a function's values below which its relation is left out
REFITTED = 0.2  # share of the sparsity that applies after that
SMOOTHNESS = 0.01  # weight of the squared second differences
AT_PLACE, OUT_OF_GRIP = 0.06, 0.1  # units: less than any move; distance from between the fingers

CELL = 2 * BORDER / CELLS  # units
_AXIS = (torch.arange(CELLS) + 0.5) * CELL - BORDER
GRID = torch.cartesian_prod(_AXIS, _AXIS)  # (CELLS * CELLS, 2)
_WEIGHTS = torch.tensor([1.0, 2.0, 1.0]) / 4  # for a cell and its neighbours, along each axis
KERNEL = torch.outer(_WEIGHTS, _WEIGHTS)[None, None]
_FINE_AXIS = torch.arange(-STEPS, STEPS + 1) * CELL / (STEPS + 1)
FINE_GRID = torch.cartesian_prod(_FINE_AXIS, _FINE_AXIS)  # offsets from a cell's centre


class PiecewiseLinear(nn.Module):
    """The sum of piecewise linear functions of R numbers, with one of several sets per row."""

    knots: Tensor  # (R, Q + 1); the last one is UNKNOWN
    weights: Tensor  # (R,) weights of the penalty: the prior against each relation
    used: Tensor  # (sets, R, 1) 1, or 0 for functions that were left out

    def __init__(self, knots: list[tuple[float, ...]], penalties: list[float], sets: int) -> None:
        super().__init__()
        table = torch.tensor([(*row, UNKNOWN) for row in knots])
        self.register_buffer("knots", table, persistent=False)
        self.register_buffer("weights", torch.tensor(penalties), persistent=False)
        self.register_buffer("used", torch.ones(sets, len(table), 1))
        self.values = nn.Parameter(torch.zeros(sets, *table.shape))

    def wanted(self, sets: Tensor) -> list[int]:
        """The positions of the numbers that any of the sets uses; at least one."""
        found: list[int] = self.used[sets, :, 0].any(dim=0).nonzero()[:, 0].tolist()
        return found or [0]

    def forward(self, numbers: Tensor, sets: Tensor, which: list[int] | None = None) -> Tensor:
        """The sums (B, ...) for numbers (B, ..., R), all or those in `which`, with sets (B,)."""
        knots, values = self.knots, (self.values * self.used).transpose(0, 1)
        if which is not None:
            knots, values = knots[which], values[which]
        count = knots.shape[1]
        flat = numbers.reshape(-1, len(knots)).T.contiguous()  # (R, P)
        known = flat < UNKNOWN - 1.0
        flat = torch.minimum(torch.maximum(flat, knots[:, :1]), knots[:, -2:-1])
        above = torch.searchsorted(knots, flat).clamp(1, count - 2)
        low, high = knots.gather(1, above - 1), knots.gather(1, above)
        share = (flat - low) / (high - low)
        above, share = above.masked_fill(~known, count - 1), share.masked_fill(~known, 1.0)
        first = sets.repeat_interleave(flat.shape[1] // len(sets)) * count  # (P,)
        values = values.flatten(1)  # (R, sets * count)
        upper, lower = values.gather(1, first + above), values.gather(1, first + above - 1)
        return (upper * share + lower * (1.0 - share)).sum(dim=0).view(numbers.shape[:-1])

    def penalty(self, sparsity: float) -> Tensor:
        """A group lasso, which leaves few of the functions, plus squared second differences.

        Yuan and Lin, "Model selection and estimation in regression with grouped variables" (2006).
        """
        norms = ((self.values * self.used) ** 2).sum(dim=2).add(TINY).sqrt()  # (sets, R)
        known = (self.values * self.used)[..., :-1]
        bends = known[..., 2:] - 2 * known[..., 1:-1] + known[..., :-2]
        sparse = (self.weights * norms).sum()
        return sparsity * sparse + SMOOTHNESS * (bends**2).sum()

    @torch.no_grad()
    def leave_out(self) -> None:
        """Permanently leave out the functions whose values have a norm below LEFT_OUT."""
        self.used.mul_(self.values.norm(dim=2, keepdim=True) >= LEFT_OUT)


class GoalModel(nn.Module):
    """Predicts the likelihood of targets and destinations; see the module."""

    def __init__(self, num_tasks: int) -> None:
        super().__init__()
        self.choice = PiecewiseLinear(
            [r.knots[0] for r in RELATIONS], [r.choice_penalty for r in RELATIONS], num_tasks
        )
        self.grip = PiecewiseLinear([GRIP_KNOTS], [GRIP_PENALTY], num_tasks)
        self.finished_bias = nn.Parameter(torch.zeros(num_tasks))
        self.finished_slope = nn.Parameter(torch.ones(num_tasks))
        penalties = [r.destination_penalty for r in RELATIONS]
        self.destination = PiecewiseLinear(  # separate sets for blocks and the robot
            [r.knots[1] for r in RELATIONS], penalties, 2 * num_tasks
        )

    def target_logits(
        self, table: ObjectTable, relations: Tensor, tasks: Tensor, which: list[int] | None = None
    ) -> Tensor:
        """Logits (B, N + 1): one for every block, and a last one for none being left to move.

        `relations` are those of every block where it lies, (B, N, R), all or those in `which`.
        """
        absent = ~table.present  # (B, N)
        scores = self.choice(relations, tasks, which).masked_fill(absent, IMPOSSIBLE)
        to_grip = (table.blocks - table.grip[:, None]).norm(dim=2)
        logits = scores + self.grip(to_grip[..., None], tasks) - NEARNESS * to_grip
        logits = logits.masked_fill(absent, IMPOSSIBLE)
        highest = scores.amax(dim=1).clamp(min=-LARGE)
        finished = self.finished_bias[tasks] - self.finished_slope[tasks] * highest
        return torch.cat([logits, finished[:, None]], dim=1)

    def destination_logits(
        self, table: ObjectTable, targets: Tensor, places: Tensor, tasks: Tensor
    ) -> Tensor:
        """Logits (B, K) of places (B, K, 2) as the destinations of targets (B,)."""
        sets = 2 * tasks + (targets == ROBOT_TARGET)
        which = self.destination.wanted(sets)
        logits: Tensor = self.destination(relate(table, targets, places, which), sets, which)
        rows = torch.arange(table.size, device=targets.device)
        robot = (targets == ROBOT_TARGET)[:, None]
        now = torch.where(robot, table.robot[:, :2], table.blocks[rows, targets.clamp(min=0)])
        far: Tensor = NEARNESS * (places - now[:, None]).norm(dim=2)
        return logits - far

    def decide(self, table: ObjectTable, tasks: Tensor) -> tuple[Tensor, Tensor]:
        """The targets (B,) and destinations (B, 2) to act on.

        The robot itself is the target if it is likely enough that no block is left to move. A block
        that lies at its destination, out of the gripper, is replaced by the next most likely one,
        and the last one by the robot.
        """
        which = self.choice.wanted(tasks)
        logits = self.target_logits(table, relate_blocks(table, which), tasks, which)
        finished = logits.softmax(dim=1)[:, -1] > SURE
        blocks = logits[:, :-1]
        targets = blocks.argmax(dim=1).masked_fill(finished, ROBOT_TARGET)
        places = self._best_places(table, targets, tasks)
        for _ in range(blocks.shape[1]):
            rows = _already_there(table, targets, places).nonzero()[:, 0]
            if not len(rows):
                break
            blocks = blocks.index_put((rows, targets[rows]), blocks.new_tensor(IMPOSSIBLE))
            best, numbers = blocks[rows].max(dim=1)
            numbers = numbers.masked_fill(best <= IMPOSSIBLE / 2, ROBOT_TARGET)
            targets = targets.index_put((rows,), numbers)
            some = self._best_places(table.select(rows), targets[rows], tasks[rows])
            places = places.index_put((rows,), some)
        return targets, places

    def _best_places(self, table: ObjectTable, targets: Tensor, tasks: Tensor) -> Tensor:
        """The best destinations (B, 2): the weighted mean of places in the best cell of a grid."""
        places = GRID.to(targets.device).expand(table.size, -1, -1)
        likelihoods = self.destination_logits(table, targets, places, tasks).softmax(dim=1)
        cells = likelihoods.view(-1, 1, CELLS, CELLS)
        around = functional.conv2d(cells, KERNEL.to(cells), padding=1)
        best = around.flatten(1).argmax(dim=1)
        places = GRID.to(targets.device)[best][:, None] + FINE_GRID.to(targets.device)
        weights = self.destination_logits(table, targets, places, tasks).softmax(dim=1)
        return (weights[..., None] * places).sum(dim=1)

    def penalty(self, sparsity: float) -> Tensor:
        """The penalties of the functions, averaged over tasks."""
        choice = self.choice.penalty(sparsity) + self.grip.penalty(sparsity)
        destination = self.destination.penalty(DESTINATION * sparsity)
        return (choice + destination) / len(self.finished_bias)

    def leave_out(self) -> None:
        """Permanently leave out the functions with small values."""
        for part in (self.choice, self.grip, self.destination):
            part.leave_out()


def goal_losses(
    model: GoalModel,
    table: ObjectTable,
    relations: Tensor,
    targets: Tensor,
    destinations: Tensor,
    tasks: Tensor,
    candidates: Tensor,
) -> tuple[Tensor, Tensor]:
    """Negative log-likelihoods of targets (B,), and of destinations (B, 2) among others (B, K, 2).

    `relations` are those of every block, (B, N, R).
    """
    logits = model.target_logits(table, relations, tasks)
    numbers = torch.where(targets == ROBOT_TARGET, logits.shape[1] - 1, targets)
    target_loss = functional.cross_entropy(logits, numbers)
    places = torch.cat([destinations[:, None], candidates], dim=1)
    scores = model.destination_logits(table, targets, places, tasks)
    return target_loss, functional.cross_entropy(scores, torch.zeros_like(targets))


def relate_blocks(table: ObjectTable, which: list[int] | None = None) -> Tensor:
    """The relations of every block where it lies, all or those in `which`: (B, N, R)."""
    count = table.blocks.shape[1]
    device = table.blocks.device
    repeated = table.select(torch.arange(table.size, device=device).repeat_interleave(count))
    numbers = torch.arange(count, device=device).repeat(table.size)
    places = table.blocks.reshape(-1, 1, 2)
    return relate(repeated, numbers, places, which).view(table.size, count, -1)


def _already_there(table: ObjectTable, targets: Tensor, places: Tensor) -> Tensor:
    """Which targets are blocks that lie at their destinations, out of the gripper: (B,) bool."""
    rows = torch.arange(table.size, device=targets.device)
    block = table.blocks[rows, targets.clamp(min=0)]
    near = (block - places).norm(dim=1) < AT_PLACE
    released = (block - table.grip).norm(dim=1) > OUT_OF_GRIP
    found: Tensor = near & released & (targets != ROBOT_TARGET)
    return found
