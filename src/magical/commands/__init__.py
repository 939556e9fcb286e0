"""The commands of `magical`, one module each: `HELP`, `configure(parser)`, `run(args) -> int`."""
