"""Make a static site of the registered environments, which can be put on any web server.

For each task it shows what to do, the scoring rule and the horizon; for each variant its scene,
what it changes, and a rollout of the scripted expert as an animation.
"""

import argparse

from magical.commands._common import (
    add_json,
    add_out,
    add_seed,
    add_tasks,
    add_workers,
    log,
    print_json,
    print_table,
)

HELP = "make a static site of the environments"


def configure(parser: argparse.ArgumentParser) -> None:
    """Describe the command's arguments."""
    add_out(parser, "folder to write index.html and images to", required=True)
    add_tasks(parser)
    add_seed(parser, "seed of the scenes")
    add_workers(parser)
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Check the folder, make the images, write the site."""
    from magical.evaluation import environments
    from magical.extras import require
    from magical.files import make_folder
    from magical.progress import ProgressBar
    from magical.report.gallery import check_site, make_previews, write_gallery

    require("report")
    env_ids = environments(args.task)
    check_site(args.out)
    make_folder(args.out)  # an unwritable folder is noticed before the rollouts
    previews = []
    with ProgressBar("environments", len(env_ids)) as bar:
        for preview in make_previews(env_ids, args.seed, args.workers):
            previews.append(preview)
            bar.advance()
    size = write_gallery(args.out, previews, args.seed)
    scores = {preview.env_id: preview.score for preview in previews}
    print_table(
        ("environment", "expert's score"),
        [(name, "–" if score is None else f"{score:.2f}") for name, score in scores.items()],
    )
    log(f"wrote {args.out / 'index.html'}, {size / 1e6:.1f} MB in total")
    print_json(args, {"out": str(args.out), "bytes": size, "scores": scores})
    return 0
