"""The language of goals: what a task asks for, as typed expressions over a scene's contents.

Selections say which blocks of the initial scene are meant, places where they should end up, and
goals how a final state is scored. A program is a single goal, for example

    Together(Each(MostCommon('shape'), AtWall('left')), Only(Enclosed()))

The language's page in the documentation lists all expressions, with examples.
"""

from magical.scene.vocabulary import Corner, Landmark, Wall
from magical.tasks.programs.expressions import Attribute, Expression
from magical.tasks.programs.goals import (
    SUCCESS,
    Clustered,
    Each,
    Every,
    Exactly,
    Goal,
    Lined,
    OneOf,
    Only,
    RobotInside,
    Together,
    Undisturbed,
    instruction,
    progress,
)
from magical.tasks.programs.parsing import VOCABULARY, parse
from magical.tasks.programs.places import (
    AtWall,
    Beside,
    InCorner,
    InOwnColour,
    InRegion,
    OutOfRegions,
    Place,
)
from magical.tasks.programs.selections import (
    AllBlocks,
    AllBut,
    And,
    Enclosed,
    Farthest,
    LikeEnclosed,
    Matched,
    Mismatched,
    MostCommon,
    Nearest,
    OddOneOut,
    OfRegionColour,
    Or,
    Outside,
    Selection,
    WithColour,
    WithShape,
    value_of,
)
from magical.tasks.programs.validity import problem

__all__ = [
    "SUCCESS",
    "VOCABULARY",
    "AllBlocks",
    "AllBut",
    "And",
    "AtWall",
    "Attribute",
    "Beside",
    "Clustered",
    "Corner",
    "Each",
    "Enclosed",
    "Every",
    "Exactly",
    "Expression",
    "Farthest",
    "Goal",
    "InCorner",
    "InOwnColour",
    "InRegion",
    "Landmark",
    "LikeEnclosed",
    "Lined",
    "Matched",
    "Mismatched",
    "MostCommon",
    "Nearest",
    "OddOneOut",
    "OfRegionColour",
    "OneOf",
    "Only",
    "Or",
    "OutOfRegions",
    "Outside",
    "Place",
    "RobotInside",
    "Selection",
    "Together",
    "Undisturbed",
    "Wall",
    "WithColour",
    "WithShape",
    "instruction",
    "parse",
    "problem",
    "progress",
    "value_of",
]
