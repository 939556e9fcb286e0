"""Tables, figures and pages, made from files; only animations also run policies.

- `found`: evaluated runs in folders
- `table`: the table of all scores; reports as HTML, Markdown, CSV
- `figures`: plots and learning curves, rollouts as animations
- `leaderboard`: checks, ranks, a static site
"""
