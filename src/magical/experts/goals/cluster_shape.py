"""Goals of ClusterShape: clusters of the same shape (appendix A.2.7)."""

from magical.experts.goals._clustering import cluster_goals
from magical.tasks.cluster_shape import shape_of

GOALS = cluster_goals(shape_of)
