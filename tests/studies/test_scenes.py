"""What a belief is worth in other scenes."""

from magical.envs import parse_env_id
from magical_goals.intent.posterior import Belief, Explanation
from magical_goals.language import Goal, parse
from magical_goals.language.programs import program_of
from studies.intent.scenes import share_right


def test_only_the_tasks_own_program_moves_the_right_blocks_in_every_scene() -> None:
    def share(program: Goal) -> float:
        belief = Belief([Explanation(program, 1.0)], unexplained=0.0, largest=1.0)
        return share_right(belief, parse_env_id("magical/MatchRegions-TestAll-v0"), moves=5)

    program = program_of("MatchRegions")
    assert share(program) == 1.0
    assert share(parse("Exactly(WithColour('green'))")) < 1.0
