"""Goals of ClusterColour: clusters of the same colour (appendix A.2.7)."""

from magical.experts.goals._clustering import cluster_planner
from magical.tasks.cluster_colour import colour_of

PLANNER = cluster_planner(colour_of)
