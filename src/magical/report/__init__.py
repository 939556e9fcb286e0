"""Tables, figures and pages, made from files; only animations also run policies.

- `found`: evaluated runs in folders
- `scores`: tables, aggregates with intervals, differences from the published rows
- `figures`: plots, learning curves, rollouts as animations
- `pages`: the results page, exported tables
- `leaderboard`: a static site
"""
