"""Write an image of a scene, with the egocentric and allocentric views side by side."""

import argparse
from pathlib import Path

import numpy as np
from PIL import Image

from magical.commands._common import UsageError, add_json, add_out, add_seed, print_json
from magical.envs import parse_env_id
from magical.envs.env import MagicalEnv
from magical.files import write_atomically


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("env_id", metavar="ENV_ID", help="for instance magical/FindDupe-TestAll-v0")
    add_seed(parser, "seed of the scene")
    add_out(parser, "file to write (default: ENV_ID with - for /, and .png)", "FILE.png")
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    env_id = parse_env_id(args.env_id)
    out = args.out or Path(f"{env_id.replace('/', '-')}.png")
    if out.suffix.lower() not in ("", ".png"):
        raise UsageError(f"{out}: expected the suffix .png")
    env = MagicalEnv(env_id.task, env_id.variant, render_mode="rgb_array")
    env.reset(seed=args.seed)
    with write_atomically(out) as file:
        Image.fromarray(np.asarray(env.render())).save(file, format="PNG")
    print(f"wrote {out}")
    print_json(args, {"env_id": env_id, "seed": args.seed, "out": str(out)})
    return 0
