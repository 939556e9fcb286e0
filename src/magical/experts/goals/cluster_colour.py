"""Goals of ClusterColour: clusters of the same colour (appendix A.2.7)."""

from magical.experts.goals._clustering import cluster_planner
from magical.tasks.programs import Attribute

PLANNER = cluster_planner(Attribute.COLOUR)
