"""Run folders of any origin: damaged records, states of other programs."""

import json
import shutil
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from baselines.tests.tiny_runs import tiny
from magical import plugins
from magical.cli import main
from magical.envs.seeds import evaluation_seed
from magical.errors import MagicalError, PluginError
from magical.evaluation import Entry, RolloutScore, environments
from magical.evaluation.entry import record_of
from magical.evaluation.protocol import Evaluation
from magical.runs import read_metrics
from magical.runs.folder import CHECKPOINT, CONFIG, METRICS, RECORD
from magical_baselines import load_policy, read_config, train
from magical_baselines.algorithms.bc import BCConfig
from magical_baselines.checkpoints import load_checkpoint, save_checkpoint

ODD: tuple[Any, ...] = (None, True, -1, 10**400, 1e308, "", "x" * 10_000, [], {}, [[]], {"a": 1})


@pytest.fixture(scope="module")
def config(demos):
    sizes: dict[str, Any] = {"num_demos": 1, "batches": 2, "checkpoint_every": 1}
    return tiny(BCConfig, demos=str(demos), **sizes)


@pytest.fixture(scope="module")
def trained(config, tmp_path_factory):
    folder = tmp_path_factory.mktemp("trained") / "run"
    train(config, folder, stop_after=1)
    return folder


@pytest.fixture
def folder(trained, tmp_path):
    return Path(shutil.copytree(trained, tmp_path / "run"))


def use(folder, config):
    """Everything that reads the folder."""
    load_policy(folder)
    read_metrics(folder)
    train(config, folder, resume=True)


def replaced(node, rng):
    """A copy of plain data with one value, at any depth, replaced or left out."""
    if rng.random() < 0.3 or not isinstance(node, dict | list) or not node:
        return ODD[int(rng.integers(len(ODD)))]
    keys: list[Any] = list(node) if isinstance(node, dict) else list(range(len(node)))
    key = keys[int(rng.integers(len(keys)))]
    copy: Any = dict(node) if isinstance(node, dict) else list(node)
    if rng.random() < 0.2:
        del copy[key]
    else:
        copy[key] = replaced(node[key], rng)
    return copy


def outcome(folder, config):
    try:
        use(folder, config)
    except MagicalError:
        return "refused"
    return "accepted"


@pytest.mark.parametrize("name", [CONFIG, RECORD, METRICS, CHECKPOINT])
def test_whatever_a_record_holds_is_accepted_or_refused(name, trained, tmp_path, config):
    rng = np.random.default_rng(0)
    outcomes: Counter[str] = Counter()
    for number in range(12):
        folder = Path(shutil.copytree(trained, tmp_path / str(number)))
        if name == CHECKPOINT:  # well-formed, of another program
            save_checkpoint(folder / name, replaced(load_checkpoint(folder / name), rng))
        else:
            text = json.dumps(replaced(json.loads((folder / name).read_text()), rng))
            (folder / name).write_text(text + "\n")
        outcomes[outcome(folder, config)] += 1
    assert outcomes["refused"] > 3


@pytest.mark.parametrize("key", ["algorithm", "network", "observation", "perception"])
def test_no_module_is_imported_because_a_record_names_it(key, folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(plugins, "_imported_names", set())  # other tests import some of them
    monkeypatch.delitem(sys.modules, "this", raising=False)
    for module in ("planted.py", "run/planted.py", "json.py", "numpy.py"):
        Path(module).write_text("raise SystemExit('imported')\n")
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "on_the_path.py").write_text("raise SystemExit('imported')\n")
    monkeypatch.syspath_prepend(tmp_path / "site")  # as an installed package is
    data = json.loads((folder / CONFIG).read_text())
    if key == "perception":
        data = {"algorithm": "object-bc"}
    files = "run/planted.py:NAME", f"{folder}/planted.py:NAME", "json.py:NAME"
    installed = "on_the_path:NAME", "unittest.__main__:main", "builtins:input", "torch:nn", "this:s"
    for name in ("planted:NAME", "\0.py:NAME", *files, *installed):
        (folder / CONFIG).write_text(json.dumps({**data, key: name}))
        with pytest.raises(PluginError, match=r"config.json names .*not one that you imported"):
            read_config(folder)
    assert not {"planted", "on_the_path", "unittest.__main__", "this"} & sys.modules.keys()


PLANTED = "from pathlib import Path\nPath(__file__).with_name('marker').touch()\n"


@pytest.mark.parametrize(
    "command",
    [
        "evaluate RUN --task MoveToCorner --variants Demo --rollouts 1 --workers 0",
        "verify RUN --workers 0",
        "report RUN --out page.html --clips 1",
        "train bc --out RUN --resume",
    ],
)
@pytest.mark.parametrize("name", ["planted_in_site:NAME", "sys:exit"])
def test_no_command_imports_what_a_run_names(name, command, folder, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "planted_in_site.py").write_text(PLANTED)
    monkeypatch.syspath_prepend(tmp_path / "site")
    evaluation = Evaluation.of(environments(["MoveToCorner"], ["Demo"]), rollouts=1)
    scores = [RolloutScore(evaluation.env_ids[0], 0, evaluation_seed(0), 0.5, 0.5)]
    policy = load_policy(folder)
    record = record_of(policy, str(folder), folder)
    Entry.of(policy, evaluation, method="A", scores=scores, record=record).write(folder)
    data = json.loads((folder / CONFIG).read_text())
    (folder / CONFIG).write_text(json.dumps({**data, "observation": name}))
    assert main(command.replace("RUN", "run").split()) == 1
    module = name.rpartition(":")[0]
    assert f"add to the command: --import {module} " in capsys.readouterr().err
    assert not (tmp_path / "site" / "marker").exists()
