"""Goals of ClusterColour: clusters of the same colour (appendix A.2.7)."""

from magical.experts.goals._clustering import cluster_goals
from magical.tasks.cluster_colour import colour_of

GOALS = cluster_goals(colour_of)
