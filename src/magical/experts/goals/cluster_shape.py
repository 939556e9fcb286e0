"""Goals of ClusterShape: clusters of the same shape (appendix A.2.7)."""

from operator import attrgetter

from magical.experts.goals._clustering import cluster_planner

PLANNER = cluster_planner(attrgetter("shape"))
