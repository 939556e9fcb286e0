"""Saved states of an episode: plain data, checked before it is used."""

from dataclasses import dataclass
from typing import Annotated, Any, cast

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from magical.errors import InvalidStateError, MagicalError
from magical.files import convert
from magical.messages import quoted
from magical.scene.constants import MAX_COORDINATE
from magical.scene.poses import FIRST_BLOCK
from magical.scene.scene import Dynamics, Scene
from magical.tasks import MAX_HORIZON, Task

_Part = Annotated[float, Meta(ge=-1.0, le=1.0)]  # of an action
_Number = Annotated[float, Meta(ge=-MAX_COORDINATE, le=MAX_COORDINATE)]


@dataclass(frozen=True, slots=True, kw_only=True)
class SavedState:
    """What `MagicalEnv.get_state` returns, from which an episode is continued.

    The bodies alone would not be enough to continue to the last bit: the solver keeps impulses
    between steps.
    """

    task: str
    variant: str
    horizon: Annotated[int, Meta(ge=1, le=MAX_HORIZON)]  # control steps in the episode
    scene: dict[str, Any]
    dynamics: dict[str, Any]
    actions: tuple[tuple[_Part, _Part, _Part], ...]  # so far: drive, turn, grip
    # After the actions: x, y, angle and their velocities, in units, radians and seconds.
    bodies: tuple[tuple[_Number, _Number, _Number, _Number, _Number, _Number], ...]
    # Whether the actions lead to these bodies. They do not in an episode that was itself restored
    # from a state whose actions led elsewhere.
    exact: bool
    rng: dict[str, Any]  # the state of a PCG64 generator, as NumPy represents it

    @staticmethod
    def parse(data: Any, task: Task) -> "tuple[SavedState, Scene, Dynamics, NDArray[np.float64]]":
        """Parse what `MagicalEnv.get_state` returns, without simulating anything.

        Returns:
            The state, and its scene, dynamics and bodies (5 + blocks, 6).

        Raises:
            InvalidStateError: another task's, or a field is missing, of a wrong type or out of
                range.
        """
        state: SavedState = convert(data, SavedState, "saved state", InvalidStateError)
        if state.task != task.name or state.variant not in task.variants:
            raise InvalidStateError(
                f"saved state: expected task {task.name} and one of its variants, found "
                f"{quoted(state.task)} and {quoted(state.variant)}"
            )
        if len(state.actions) > state.horizon:
            raise InvalidStateError(
                f"saved state: actions: expected at most {state.horizon} (the horizon), found "
                f"{len(state.actions)}"
            )
        try:
            scene, dynamics = Scene.from_dict(state.scene), Dynamics.from_dict(state.dynamics)
            task.validate(scene)
            np.random.PCG64().state = cast(Any, state.rng)
        except (MagicalError, TypeError, ValueError, KeyError, OverflowError) as error:
            raise InvalidStateError(f"saved state: scene, dynamics or rng: {error}") from error
        if len(state.bodies) != FIRST_BLOCK + len(scene.blocks):
            raise InvalidStateError(
                f"saved state: bodies: expected {FIRST_BLOCK + len(scene.blocks)}, found "
                f"{len(state.bodies)}"
            )
        return state, scene, dynamics, np.array(state.bodies)
