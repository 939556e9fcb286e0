"""Write an image of a scene, egocentric and allocentric view side by side."""

import argparse
from pathlib import Path

from magical.commands._common import add_json, add_seed, print_json, write_image
from magical.envs import parse_env_id

HELP = "write an image of a scene"


def configure(parser: argparse.ArgumentParser) -> None:
    """Describe the command's arguments."""
    parser.add_argument("env_id", metavar="ENV_ID", help="for instance magical/FindDupe-TestAll-v0")
    add_seed(parser, "which scene is sampled")
    parser.add_argument(
        "--out", type=Path, metavar="FILE.png", help="default: the id, slashes replaced, .png"
    )
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Reset the environment and save its rendering."""
    import gymnasium
    import numpy as np

    env_id = parse_env_id(args.env_id)
    out = args.out or Path(f"{env_id.replace('/', '-')}.png")
    env = gymnasium.make(env_id, render_mode="rgb_array")
    env.reset(seed=args.seed)
    write_image(out, np.asarray(env.render(), dtype=np.uint8))
    env.close()
    print(f"wrote {out}")
    if args.json:
        print_json({"env_id": env_id, "seed": args.seed, "out": str(out)})
    return 0
