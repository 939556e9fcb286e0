"""Configurations that version 0.1.0 has written are still read, by today's names."""

import json
from pathlib import Path
from typing import Any

import pytest

from magical.errors import InvalidConfigError
from magical.learning import find_algorithm, read_config
from magical.runs.folder import CONFIG

OLD = [
    json.loads(line)
    for line in Path(__file__).with_name("old_configurations.jsonl").read_text().splitlines()
]
PRESETS = OLD[:-2]  # of every algorithm, in their order, for ClusterColour with seed 3
LATER = ("states",)  # presets that it did not have


def read(data: dict[str, Any], folder: Path) -> Any:
    (folder / CONFIG).write_text(json.dumps(data))
    return read_config(folder)


def test_presets_are_todays(tmp_path: Path) -> None:
    given = {"tasks": ("ClusterColour",), "seed": 3}
    expected = [
        find_algorithm(name).config.preset(
            preset, **given, **({} if name == "ppo" else {"demos": "d"})
        )
        for name in dict.fromkeys(data["algorithm"] for data in PRESETS)
        for preset in find_algorithm(name).config.presets
        if preset not in LATER
    ]
    assert [read(data, tmp_path) for data in PRESETS] == expected


def test_renamed_settings_keep_their_values_and_constants_are_dropped(tmp_path: Path) -> None:
    gail, objects = (read(data, tmp_path) for data in OLD[-2:])
    assert (gail.ppo.clip_range, gail.ppo.gamma, gail.ppo.ent_coef) == (0.3, 0.7, 0.01)
    assert (gail.ppo.num_steps, gail.networks.conventions) == (5, "appendix")
    assert (objects.block_range, objects.wall_range) == (1.0, 3.0)


def test_settings_of_no_version_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidConfigError, match=r"config.json: setting 'odd' is unknown"):
        read({**OLD[0], "odd": 1}, tmp_path)
