"""The language of goals: what a task asks for, as typed expressions over a scene's contents.

Selections say which blocks of the initial scene are meant, places where they should end up
(`expressions`), and goals how a final state is scored (`goals`). A program is a single goal, such
as `Together(Each(MostCommon('shape'), AtWall('left')), Only(Enclosed()))`.
"""

from magical_goals.language.goals import Goal, problem, progress
from magical_goals.language.parsing import VOCABULARY, parse

__all__ = ["VOCABULARY", "Goal", "parse", "problem", "progress"]
