"""`magical bench training`: which precision and number of threads is fastest here."""

import argparse
from dataclasses import asdict

from magical.commands._common import print_json, print_table


def run_training(args: argparse.Namespace) -> int:
    """Measure, print, recommend options of `magical train`."""
    from magical.learning.running.devices import choose_compute
    from magical.learning.running.speed import training_speeds

    speeds = training_speeds(args.network, args.batch_size, args.device)
    fastest = max(speeds, key=lambda way: speeds[way])
    default = choose_compute(fastest.device, "auto", 0)
    rows = [
        (
            way.device,
            way.precision,
            str(way.threads or ""),
            f"{speed:,.0f}",
            " and ".join(
                name for name, one in (("default", default), ("fastest", fastest)) if one == way
            ),
        )
        for way, speed in speeds.items()
    ]
    print(f"network {args.network}, batches of {args.batch_size}, forward and backward")
    print_table(("device", "precision", "threads", "samples/s", ""), rows)
    options = f"--precision {fastest.precision}"
    if fastest.threads:
        options += f" --threads {fastest.threads}"
    print(f"fastest: magical train ... {options}")
    if args.json:
        ways = [{**asdict(way), "samples_per_second": speed} for way, speed in speeds.items()]
        print_json({"network": args.network, "batch_size": args.batch_size, "ways": ways})
    return 0
