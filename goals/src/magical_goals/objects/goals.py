"""Which block is moved next, and where to: sums of functions of single relations.

Each relation has a piecewise linear function, learned for each task. The logit of a block is the
sum over the relations that it has where it lies; the logit of a destination is the sum over those
that the block would have there. A sum has no order, and each term depends on one kind of object, so
the model carries over to other counts, colours and layouts. Nothing is left to do once no block has
a high score. The model is trained by maximum likelihood of the goals found in hindsight, with a
group lasso: few and simple relations have to explain all demonstrations.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

from magical_goals.objects.hindsight import ROBOT_TARGET
from magical_goals.objects.relations import RELATIONS, UNKNOWN, relate
from magical_goals.objects.table import ObjectTable

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
        """The sums (B, ...) for numbers (B, ..., R), with the functions of the sets (B,).

        If only some of the numbers are given, `which` has their positions.
        """
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

        Args:
            table: B scenes.
            relations: of every block where it lies, (B, N, R).
            tasks: (B,).
            which: the positions of the relations that are given; None: all.
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
        """The best destinations (B, 2): the weighted mean of places in the best cell of a grid.

        A cell is judged by the likelihood of its neighbourhood, as no block is put down exactly.
        """
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
    """Negative log-likelihoods of targets, and of destinations among candidates.

    Args:
        model: the model.
        table: B scenes.
        relations: of every block, (B, N, R).
        targets: (B,).
        destinations: (B, 2).
        tasks: (B,).
        candidates: other places, (B, K, 2).
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
