"""The commands of `magical`, one module each: `configure(parser)` and `run(args) -> int`.

A module is imported when its command is used; its docstring is the command's description.
"""

HELP = {
    "demos": "demonstrations: import, generate, replay, export, push",
    "envs": "list tasks, variants and horizons",
    "evaluate": "score a policy on the test variants",
    "leaderboard": "rank evaluated entries on a static page",
    "report": "make a page of tables from evaluated runs",
    "show": "write an image of a scene",
    "verify": "rerun a sample of an entry's rollouts",
}
