"""Goals of ClusterColour: clusters of the same colour (appendix A.2.7)."""

from operator import attrgetter

from magical.experts.goals._clustering import cluster_planner

PLANNER = cluster_planner(attrgetter("colour"))
