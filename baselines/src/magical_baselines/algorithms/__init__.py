"""The algorithms, one per file, named after the algorithm (with `_` for `-`).

Each file has a configuration class, `train(config, run)`, `make_policy(config)` and, at its end,
`ALGORITHM = Algorithm(...)`. Algorithms are found through the entry-point group
`magical.algorithms`, those of this distribution as well, and any other by `module:NAME`.
"""
