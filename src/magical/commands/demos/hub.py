"""`magical demos push` and `pull`."""

import argparse

from magical.commands._common import print_json


def run_push(args: argparse.Namespace) -> int:
    """`magical demos push`."""
    from magical.demos import Dataset
    from magical.demos.export.hub import push

    dataset = Dataset.open(args.dataset)
    address = push(dataset, args.repo, args.licence, private=args.private)
    print(f"pushed {len(dataset)} demonstrations to {address}")
    print_json(args, {"repository": address, "count": len(dataset)})
    return 0


def run_pull(args: argparse.Namespace) -> int:
    """`magical demos pull`."""
    from magical.demos.export.hub import pull

    dataset = pull(args.repo, args.out, args.revision)
    print(f"pulled {len(dataset)} demonstrations into {args.out}")
    print_json(args, {"out": str(args.out), "count": len(dataset)})
    return 0
