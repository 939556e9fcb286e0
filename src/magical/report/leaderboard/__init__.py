"""A leaderboard of evaluated entries, as static pages.

- `checks`: whether an entry is what docs/protocol.md asks for.
- `ranking`: the methods in order.
- `site`: the pages.
"""

from magical.report.leaderboard.site import Leaderboard, make_leaderboard

__all__ = ["Leaderboard", "make_leaderboard"]
