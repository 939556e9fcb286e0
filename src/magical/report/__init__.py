"""Tables, figures and pages, made from files; only animations also run policies.

- `found`: evaluated runs in folders
- `table`: the table of all scores, and what is read from it
- `page`: reports as HTML, Markdown and CSV
- `figures`: plots, learning curves, rollouts as animations
- `leaderboard`: checks, ranks, a static site
"""
