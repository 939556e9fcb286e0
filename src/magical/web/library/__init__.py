"""Looking at episodes: datasets and runs that the page lists, and what it shows of them.

- `sources`: datasets, and the rollouts of this session, by key; their episodes, by number.
- `policies`: the scripted expert and the runs, by number; loaded when they are first used.
- `rollouts`: whole episodes of a policy, kept in memory.
- `viewing`: an episode step by step: frames, actions, scores, action probabilities.
- `queries`: what the page may ask for, checked.
- `routes`: the HTTP routes, which compute in threads.
"""
