"""Many environments at once: Gymnasium's vector environment, over worker processes.

- `env`: `MagicalVectorEnv`, what users call
- `sub_envs`: some of its sub-environments, stepped one after the other in one process
- `workers`, `worker`: the parent's and the child's side of worker processes
- `buffers`: the memory that sub-environments write to and the caller reads from
"""

from magical.envs.vector.env import MagicalVectorEnv, make_vector_env

__all__ = ["MagicalVectorEnv", "make_vector_env"]
