"""Viewing episodes: what the page lists, and what it shows of an episode.

- `sources`: datasets, and the rollouts made on this server, by key; their episodes, by number.
- `viewing`: an episode step by step: frames, actions, scores.
- `routes`: the HTTP routes, whose work runs in threads.
"""
