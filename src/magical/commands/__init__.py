"""The commands of `magical`, a file each: `HELP`, `configure(parser)`, `run(args) -> int`."""
