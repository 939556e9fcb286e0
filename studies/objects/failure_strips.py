"""A picture of where a policy fails: the worst rollouts of each task, as strips of frames.

python studies/objects/failure_strips.py RUN... --out failures.png [--rollouts 3]

RUN is a run folder with weights and an entry. The rollouts with the lowest scores, of equals the
first, are run again with its seeds, horizon and nudge.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

from magical.evaluation import Entry, RolloutScore, read_entry
from magical.learning import load_policy
from magical.report.figures import Clip, record_rollouts
from magical.tasks.axes import full_variant

MARGIN, FONT_SIZE = 6, 13
INK, PAPER = "#26262b", "#ffffff"


def main() -> None:
    assert __doc__
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("runs", nargs="+", help="run folders")
    parser.add_argument("--out", type=Path, required=True, metavar="PNG")
    parser.add_argument("--variant", default="All")
    parser.add_argument("--rollouts", type=int, default=3, help="of each task")
    parser.add_argument("--frames", type=int, default=10, help="of each rollout")
    parser.add_argument("--size", type=int, default=96, help="pixels across a frame")
    args = parser.parse_args()
    clips = [each for run in args.runs for each in failures(run, args)]
    if not clips:
        raise SystemExit(f"expected rollouts of {args.variant} with a score below 1, found none")
    picture(clips, args.frames).save(args.out, optimize=True)


def failures(run: str, args: argparse.Namespace) -> list[tuple[RolloutScore, Clip]]:
    """The worst rollouts of each task of a run."""
    entry, policy = read_entry(Path(run)), load_policy(run)
    clips: list[tuple[RolloutScore, Clip]] = []
    for task in dict.fromkeys(row.env_id.task for row in entry.scores):
        worst = worst_rollouts(entry, task, full_variant(args.variant), args.rollouts)
        if not worst:
            continue
        recorded = record_rollouts(
            policy,
            entry.evaluation(policy),
            [(row.env_id, row.rollout) for row in worst],
            size=args.size,
        )
        for row, clip in zip(worst, recorded, strict=True):
            clips.append((row, clip))
            print(f"{row.env_id} rollout {row.rollout}: {row.score:.2f}, again {clip.score:.2f}")
    return clips


def worst_rollouts(entry: Entry, task: str, variant: str, count: int) -> list[RolloutScore]:
    """The rollouts with the lowest scores below 1 by the appendix's rule, the first of equals."""
    own = [r for r in entry.scores if (r.env_id.task, r.env_id.variant) == (task, variant)]
    rows = [row for row in own if row.score < 1.0]
    return sorted(rows, key=lambda row: row.score)[:count]


def picture(clips: Sequence[tuple[RolloutScore, Clip]], frames: int) -> Image.Image:
    """Strips below one another, each with its task, rollout and score."""
    font = ImageFont.load_default(FONT_SIZE)
    strips = [Image.fromarray(clip.strip(frames)) for _, clip in clips]
    width, height = strips[0].size
    left = MARGIN * 2 + round(max(font.getlength(row.env_id.task) for row, _ in clips))
    tasks = list(dict.fromkeys(row.env_id.task for row, _ in clips))
    gaps = [2 * MARGIN * tasks.index(row.env_id.task) for row, _ in clips]
    sheet = Image.new(
        "RGB", (left + width + MARGIN, gaps[-1] + (height + MARGIN) * len(clips)), PAPER
    )
    pen = ImageDraw.Draw(sheet)
    for number, ((row, clip), strip) in enumerate(zip(clips, strips, strict=True)):
        top = (height + MARGIN) * number + gaps[number]
        text = f"{row.env_id.task}\nrollout {row.rollout}\nscore {clip.score:.2f}"
        pen.multiline_text((MARGIN, top + MARGIN), text, INK, font)
        sheet.paste(strip, (left, top))
    return sheet


if __name__ == "__main__":
    main()
