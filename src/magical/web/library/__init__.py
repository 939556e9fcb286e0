"""Looking at episodes: what the page lists, and what it shows of an episode.

- `sources`: datasets, and the rollouts of this session, by key; their episodes, by number.
- `viewing`: an episode step by step: frames, actions, scores.
- `routes`: the HTTP routes, which compute in threads.
"""
