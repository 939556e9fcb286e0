"""Goals of FixColour: the mismatched block in no region, each other in its own (appendix A.2.6)."""

from functools import partial

from magical.experts.goals._programs import plan
from magical.experts.planning import Planner
from magical.tasks.fix_colour import PROGRAM

PLANNER = Planner(partial(plan, PROGRAM))
