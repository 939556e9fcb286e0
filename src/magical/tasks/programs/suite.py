"""The suite of generated tasks: 64 to develop learners on, 32 held out for a final evaluation.

These are the first numbers whose program is neither one of the paper's tasks nor that of a lower
number, and whose task the scripted expert solves (`LEAST_SCORES`; studies/generated_tasks). Every
third one is held out.
"""

SIZE = 96
LEAST_SCORES = {"Demo": 0.9, "All": 0.8}  # minimum mean scores of the expert, by variant

# fmt: off
SUITE = (
    1, 2, 4, 5, 6, 7, 8, 9, 11, 12, 13, 16, 17, 20, 21, 22, 24, 25, 29, 30, 32, 33, 35, 37, 38,
    41, 42, 43, 46, 47, 49, 50, 51, 52, 53, 54, 56, 58, 61, 63, 65, 66, 67, 69, 72, 74, 81, 83,
    84, 85, 87, 90, 92, 94, 107, 108, 111, 112, 115, 117, 119, 120, 121, 123, 128, 129, 138,
    140, 142, 147, 149, 151, 152, 154, 156, 160, 162, 165, 166, 167, 169, 170, 171, 180, 182,
    183, 184, 185, 187, 188, 190, 199, 204, 205, 207, 211,
)
# fmt: on
HELD_OUT = SUITE[2::3]
TRAINING = tuple(number for number in SUITE if number not in HELD_OUT)


def task_name(number: int) -> str:
    """The name of a generated task."""
    return f"Generated{number:04d}"
