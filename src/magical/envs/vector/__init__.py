"""Many environments at once: Gymnasium's vector environment, over worker processes.

- `env`: `MagicalVectorEnv`, which users call
- `sub_envs`: some of its sub-environments, stepped one after the other in one process
- `workers`: worker processes, each with some of the sub-environments
- `buffers`: the memory that sub-environments write to and the caller reads from
- `checks`: checks of arguments
"""

from magical.envs.vector.env import MagicalVectorEnv, make_vector_env

__all__ = ["MagicalVectorEnv", "make_vector_env"]
