"""A leaderboard of evaluated entries, as static pages.

- `checks`: whether an entry follows docs/protocol.md.
- `ranking`: the ranked methods.
- `site`: the pages.
"""

from magical.report.leaderboard.site import Leaderboard, make_leaderboard

__all__ = ["Leaderboard", "make_leaderboard"]
