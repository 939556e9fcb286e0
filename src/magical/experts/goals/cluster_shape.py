"""Goals of ClusterShape: clusters of the same shape (appendix A.2.7)."""

from magical.experts.goals._clustering import cluster_planner
from magical.tasks.cluster_shape import shape_of

PLANNER = cluster_planner(shape_of)
