"""Make a static site of the registered environments, to be put on any web server.

For each task it has what to do, the score rule and the horizon; for each variant its scene, what it
changes, and a rollout of the scripted expert as an animation.
"""

import argparse
from pathlib import Path

from magical.commands._common import (
    add_json,
    log,
    non_negative_int,
    positive_int,
    print_json,
    print_table,
)

HELP = "make a static site of the environments"


def configure(parser: argparse.ArgumentParser) -> None:
    """Describe the command's arguments."""
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="write index.html and images there"
    )
    parser.add_argument(
        "--task", action="append", metavar="TASK", help="may be repeated (default: all)"
    )
    parser.add_argument(
        "--seed",
        type=non_negative_int,
        default=0,
        metavar="S",
        help="which scenes are sampled (default: 0)",
    )
    parser.add_argument(
        "--workers", type=positive_int, metavar="K", help="processes (default: one for each core)"
    )
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Check the folder, make the images, write the site."""
    from magical.evaluation import environments
    from magical.extras import require
    from magical.progress import progress_bar
    from magical.report.gallery import Gallery, check_site, make_previews

    require("report")
    env_ids = environments(args.task)
    check_site(args.out)
    previews = []
    with progress_bar("environments", len(env_ids)) as advance:
        for preview in make_previews(env_ids, args.seed, args.workers):
            previews.append(preview)
            advance(1)
    size = Gallery(previews, args.seed).write(args.out)
    scores = {preview.env_id: preview.score for preview in previews}
    print_table(
        ("environment", "expert's score"),
        [(name, "–" if score is None else f"{score:.2f}") for name, score in scores.items()],
    )
    log(f"wrote {args.out / 'index.html'}, {size / 1e6:.1f} MB in all")
    if args.json:
        print_json({"out": str(args.out), "bytes": size, "scores": scores})
    return 0
