"""How well apprenticeship learning's autoencoder reconstructs demonstrations it has not seen.

    python studies/learners/autoencoder.py --task MoveToRegion --out runs/autoencoder

Pretrains as `magical train al --preset quick` does, on 25 demonstrations by the scripted expert,
then reconstructs every frame stack of 25 others. Writes a picture of some: originals above, what
became of them below. Needs the extra learning.
"""

import argparse
from pathlib import Path

import numpy as np
import torch

from magical.demos.generate import demonstrate, generate
from magical.learning import train
from magical.learning.algorithms.al import ALConfig, make_autoencoder
from magical.learning.augmentation.augment import to_unit
from magical.learning.autoencoder import save_reconstructions
from magical.learning.data.expert_data import ExpertData, sample_demonstrations
from magical.learning.running.checkpoints import load_checkpoint
from magical.runs import is_run
from magical.runs.folder import CHECKPOINT

NUMBER = 25  # of demonstrations, learned from and held out
HELD_OUT = 10_000  # first seed of the held-out ones
QUICK = ALConfig.preset("quick", tasks=("MoveToRegion",), demos="").pretraining_batches
CHUNK = 64  # samples at a time
SHOWN = 10


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--task", default="MoveToRegion")
    parser.add_argument("--out", type=Path, required=True, help="demonstrations, run, picture")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--batches", type=int, default=QUICK, help="default: the preset's")
    args = parser.parse_args()
    demo, demos = f"magical/{args.task}-Demo-v0", args.out / "demos"
    if not demos.exists():
        generate(demo, NUMBER, demos)
    config = ALConfig.preset(
        "quick",
        tasks=(args.task,),
        demos=str(demos),
        num_demos=NUMBER,
        seed=args.seed,
        pretraining_batches=args.batches,
    )
    folder = args.out / f"al-{args.task}-{args.batches}"
    train(config, folder, stop_after=config.pretraining_batches, resume=is_run(folder))
    autoencoder = make_autoencoder(config).eval()
    autoencoder.load_state_dict(load_checkpoint(folder / CHECKPOINT)["autoencoder"])
    chosen = sample_demonstrations(str(demos), config.tasks, NUMBER, config.seed)
    seen = ExpertData(chosen.trajectories, config.tasks, config.observation_spec)
    held_out = ExpertData(
        [(args.task, demonstrate(demo, HELD_OUT + i)) for i in range(NUMBER)],
        config.tasks,
        config.observation_spec,
    )
    report(autoencoder, seen, held_out, args.out / f"{args.task}-{args.batches}.png")


def report(
    autoencoder: torch.nn.Module, seen: ExpertData, held_out: ExpertData, picture: Path
) -> None:
    """Mean squared errors of pixels in [0, 1], beside those of the mean of the seen images."""
    total = [to_unit(seen.images(rows)).sum(dim=0) for rows in chunks(seen)]
    mean = torch.stack(total).sum(dim=0) / len(seen)
    for name, data in (("seen", seen), ("held out", held_out)):
        errors = [errors_of(autoencoder, data, rows, mean) for rows in chunks(data)]
        ours, plain = torch.cat(errors, dim=1).mean(dim=1).tolist()
        print(f"{name}: {ours:.5f}; the mean image {plain:.5f}; {ours / plain:.1%}", flush=True)
    rows = np.linspace(0, len(held_out) - 1, SHOWN).astype(np.int64)
    images = to_unit(held_out.images(rows))
    with torch.inference_mode():
        reconstructed, _ = autoencoder(images, held_out.labels(rows)[0])
    save_reconstructions(picture, images, reconstructed)


def errors_of(
    autoencoder: torch.nn.Module, data: ExpertData, rows: np.ndarray, mean: torch.Tensor
) -> torch.Tensor:
    """The autoencoder's and the mean image's squared errors, (2, B)."""
    images = to_unit(data.images(rows))
    with torch.inference_mode():
        reconstructed, _ = autoencoder(images, data.labels(rows)[0])
    guesses = (reconstructed, mean.expand_as(images))
    return torch.stack([(guess - images).square().mean(dim=(1, 2, 3)) for guess in guesses])


def chunks(data: ExpertData) -> list[np.ndarray]:
    """All rows, some at a time."""
    return [np.arange(i, min(i + CHUNK, len(data))) for i in range(0, len(data), CHUNK)]


if __name__ == "__main__":
    main()
