"""The suite of generated tasks: 64 to develop learners on, 32 held out for a final evaluation.

They are the first numbers whose program is neither one of the paper's tasks nor that of a lower
number, and which the scripted expert solves (`LEAST_SCORES`; studies/generated_tasks). Every third
one is held out.
"""

SIZE = 96
LEAST_SCORES = {"Demo": 0.9, "TestAll": 0.8}  # the expert's mean scores

SUITE = tuple(range(SIZE))
HELD_OUT = SUITE[2::3]
TRAINING = tuple(number for number in SUITE if number not in HELD_OUT)


def task_name(number: int) -> str:
    """The name of a generated task."""
    return f"Generated{number:04d}"
