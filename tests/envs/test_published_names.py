"""Names of the published package are answered by what replaces them."""

from typing import Any

import gymnasium
import pytest

import magical
from magical import cli
from magical.envs.vector import MagicalVectorEnv
from magical.evaluation import published_tasks

PUBLISHED_IDS = [
    env_id for env_id in magical.all_env_ids(presets=True) if env_id.task in published_tasks()
]


def test_every_published_id_is_an_alias() -> None:
    assert len(PUBLISHED_IDS) == 360
    for env_id in PUBLISHED_IDS:
        old, new = (gymnasium.spec(name) for name in (env_id.removeprefix("magical/"), env_id))
        assert old.kwargs == {**new.kwargs, "new_id": env_id}


def test_an_alias_makes_the_environment_and_names_the_new_id() -> None:
    with pytest.warns(DeprecationWarning, match="LoRes4E-v0 is now magical/ClusterColour-Demo-LoR"):
        old: Any = gymnasium.make("ClusterColour-Demo-LoRes4E-v0", horizon=3).unwrapped
    new: Any = gymnasium.make("magical/ClusterColour-Demo-LoRes4E-v0").unwrapped
    assert (type(old), old.env_id, old.horizon) == (type(new), new.env_id, 3)
    assert old.observation_spec == new.observation_spec
    with pytest.warns(DeprecationWarning, match="is now"):
        gymnasium.make("MakeLine-Demo-v0", render_mode="rgb_array_list").close()
    with pytest.warns(DeprecationWarning, match="is now magical/MakeLine-Demo-v0") as caught:
        envs = gymnasium.make_vec("MakeLine-Demo-v0", 2, workers=0, observation="state")
    assert isinstance(envs, MagicalVectorEnv)
    assert caught[0].filename == __file__


def test_register_envs_says_that_it_does_nothing() -> None:
    with pytest.warns(DeprecationWarning, match="importing magical registers"):
        magical.register_envs()


def test_the_published_option_names_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--env-name", "MoveToCorner-Demo-v0"]) == 2
    assert "use `magical play --env ID`" in capsys.readouterr().err
