"""Run folders of any origin: special files, damaged records, states of other programs."""

import json
import os
import shutil
import sys
from collections import Counter
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import torch

from magical.errors import MagicalError, PluginError
from magical.learning import load_policy, read_config, train
from magical.learning.algorithms.bc import BCConfig
from magical.learning.running.checkpoints import load_checkpoint, save_checkpoint
from magical.plugins import import_user_module
from magical.runs import read_metrics
from magical.runs.folder import CHECKPOINT, CONFIG, METRICS, PREVIOUS, RECORD
from tests.learning.tiny_runs import tiny

ODD: tuple[Any, ...] = (None, True, -1, 10**400, 1e308, "", "x" * 10_000, [], {}, [[]], {"a": 1})


@pytest.fixture(scope="module")
def config(demos: Path) -> BCConfig:
    sizes: dict[str, Any] = {
        "num_demos": 1,
        "batches": 2,
        "average_decay": 0.5,
        "checkpoint_every": 1,
    }
    return tiny(BCConfig, demos=str(demos), **sizes)


@pytest.fixture(scope="module")
def trained(config: BCConfig, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("trained") / "run"
    train(config, folder, stop_after=1)
    return folder


@pytest.fixture
def folder(trained: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(trained, tmp_path / "run"))


def use(folder: Path, config: BCConfig) -> None:
    """Everything that reads the folder."""
    load_policy(folder)
    read_metrics(folder)
    train(config, folder, resume=True)


@pytest.mark.posix
@pytest.mark.parametrize("name", [CONFIG, RECORD, METRICS, CHECKPOINT])
def test_special_files_are_refused(name: str, folder: Path, config: BCConfig) -> None:
    (folder / PREVIOUS).unlink(missing_ok=True)
    (folder / name).unlink()
    os.mkfifo(folder / name)
    with pytest.raises(MagicalError, match=r"run"):
        use(folder, config)


def replaced(node: Any, rng: np.random.Generator) -> Any:
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


def outcome(folder: Path, config: BCConfig) -> str:
    try:
        use(folder, config)
    except MagicalError:
        return "refused"
    return "accepted"


@pytest.mark.parametrize("name", [CONFIG, RECORD, METRICS, CHECKPOINT])
def test_whatever_a_record_holds_is_accepted_or_refused(
    name: str, trained: Path, tmp_path: Path, config: BCConfig
) -> None:
    rng = np.random.default_rng(0)
    outcomes: Counter[str] = Counter()
    for number in range(12):
        folder = Path(shutil.copytree(trained, tmp_path / str(number)))
        if name == CHECKPOINT:  # well-formed and with its digest, of another program
            save_checkpoint(folder / name, replaced(load_checkpoint(folder / name), rng))
        else:
            text = json.dumps(replaced(json.loads((folder / name).read_text()), rng))
            (folder / name).write_text(text + "\n")
        outcomes[outcome(folder, config)] += 1
    assert outcomes["refused"] > 3


@pytest.mark.parametrize("key", ["algorithm", "network", "observation", "perception"])
def test_no_module_of_the_working_folder_is_imported_on_a_record_s_word(
    key: str, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "this", raising=False)  # another test may have imported it
    for module in ("planted.py", "run/planted.py", "json.py", "numpy.py", "timm.py"):
        Path(module).write_text("raise SystemExit('imported')\n")
    data = json.loads((folder / CONFIG).read_text())
    files = "run/planted.py:NAME", f"{folder}/planted.py:NAME", "json.py:NAME", "numpy.py:NAME"
    models = ["timm:NAME"] if key != "network" else []
    for name in ("planted:NAME", *files, "this:s", *models):
        (folder / CONFIG).write_text(json.dumps({**data, key: name}))
        with pytest.raises(PluginError, match=r"config.json names .*not installed.*--import"):
            read_config(folder)


def test_other_modules_of_an_imported_package_may_be_named(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = json.loads((folder / CONFIG).read_text())
    (folder / CONFIG).write_text(json.dumps({**data, "network": "imported_package.nets:NETWORK"}))
    with pytest.raises(PluginError, match="not installed"):
        read_config(folder)
    monkeypatch.setitem(sys.modules, "imported_package", ModuleType("imported_package"))
    assert read_config(folder).to_dict()["network"] == "imported_package.nets:NETWORK"


def test_a_file_that_the_user_imported_may_be_named(folder: Path, tmp_path: Path) -> None:
    data = json.loads((folder / CONFIG).read_text())
    name = f"{tmp_path / 'own_network.py'}:NETWORK"
    (tmp_path / "own_network.py").write_text("NETWORK = None\n")
    (folder / CONFIG).write_text(json.dumps({**data, "network": name}))
    with pytest.raises(PluginError, match="not installed"):
        read_config(folder)
    import_user_module(name.rpartition(":")[0])
    assert read_config(folder).to_dict()["network"] == name


def test_gpu_memory_that_does_not_suffice_is_named(
    config: BCConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def exhausted(*_: Any) -> None:
        raise torch.OutOfMemoryError("CUDA out of memory")

    monkeypatch.setattr("magical.learning.algorithms.bc.BCTrainer.step", exhausted)
    with pytest.raises(MagicalError, match=r"not enough memory.*--batch-size"):
        train(config, tmp_path / "run")
