"""Goals of MatchRegions: all and only blocks of the region's colour inside (appendix A.2.3)."""

from functools import partial

from magical.experts.goals._programs import plan
from magical.experts.planning import Planner
from magical.tasks.match_regions import PROGRAM

PLANNER = Planner(partial(plan, PROGRAM))  # `program_planner` would stop once solved
