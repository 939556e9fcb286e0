"""Tables, figures and pages; from files alone.

- `found`: evaluated runs in folders, what is missing among them, how each was made
- `scores`: tables, aggregates with intervals, differences from the published rows
- `figures`: plots, learning curves, rollouts as animations
- `pages`: a page, the comparison of two methods, exported tables
- `leaderboard` and `gallery`: static sites
"""
