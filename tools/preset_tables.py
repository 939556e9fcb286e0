"""A table of an algorithm's settings by preset, with the appendix's values."""

from collections.abc import Iterator, Mapping
from dataclasses import MISSING
from typing import Any

from magical_baselines import Config
from magical_baselines.config import Field, options
from tools.readme_tables import table

# Values that the appendix states: its section B, Tables 3 and 4.
SECTION_B: Mapping[str, Any] = {
    "num_demos": 10,
    "observation": "LoRes4E",
    "network": "paper",
    "conventions": "appendix",
}
TABLE_3: Mapping[str, Any] = {
    "batches": 20_000,
    "batch_size": 32,
    "optimizer": "sgd",
    "learning_rate": 1e-3,
    "momentum": 0.1,
    "augment": "all",
}
TABLE_4: Mapping[str, Any] = {
    "num_envs": 32,
    "num_steps": 8,
    "epochs": 12,
    "minibatch_size": 64,
    "learning_rate": 6e-5,
    "anneal": True,
    "gamma": 0.8,
    "gae_lambda": 0.8,
    "ent_coef": 1e-5,
    "clip_range": 0.01,
    "max_grad_norm": 1.0,
    "total_steps": 1_000_000,
    "horizon": "appendix",
}
DISCRIMINATOR: Mapping[str, Any] = {  # of Table 4
    "discriminator_batch_size": 24,
    "discriminator_learning_rate": 2.5e-5,
    "discriminator_steps": 12,
    "augment": "all",
    "reward_std": 0.1,
    "penalty_weight": 100.0,
}
AUTOENCODER: Mapping[str, Any] = {  # of section B, "Apprenticeship learning baseline"
    "pretraining_batches": 8192,
    "pretraining_batch_size": 24,
    "feature_samples": 512,
    "reward_std": 0.1,
}
SOURCES = {
    "bc": [TABLE_3],
    "gail": [TABLE_4, DISCRIMINATOR],
    "wgail-gp": [TABLE_4, DISCRIMINATOR],
    "al": [TABLE_4, AUTOENCODER],
}


def appendix(kind: type[Config]) -> dict[str, Any]:
    """The values that the appendix states for an algorithm, by field; empty if it has none."""
    if kind.algorithm not in SOURCES:
        return {}
    merged: dict[str, Any] = {}
    for source in (SECTION_B, *SOURCES[kind.algorithm]):
        merged |= source
    return {option.name: merged[option.name] for option in options(kind) if option.name in merged}


def settings(kind: type[Config]) -> str:
    """A row for each optional setting, a column for each preset; differences from `paper` bold."""
    stated = appendix(kind)
    header = ["Setting", *(f"`{name}`" for name in columns(kind))]
    header += ["Appendix"] if stated else []
    rows = [
        [*row(kind, option), *([shown(stated.get(option.name, ""))] if stated else [])]
        for option in options(kind)
        if option.default is not MISSING
    ]
    return table(header, rows)


def flag(option: Field) -> str:
    """The option on the command line."""
    return "--task" if option.name == "tasks" else f"--{option.name.replace('_', '-')}"


def columns(kind: type[Config]) -> list[str]:
    """The presets' names, `paper` first."""
    return sorted(kind.presets, key=lambda name: (name != "paper", name))


def row(kind: type[Config], option: Field) -> Iterator[str]:
    """The setting's name and its value in each preset."""
    yield f"`{flag(option)}`"
    paper = kind.presets["paper"].get(option.name, option.default)
    for name in columns(kind):
        value = kind.presets[name].get(option.name, option.default)
        yield shown(value) if value == paper else f"**{shown(value)}**"


def shown(value: Any) -> str:
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: "one per core"}[value]
    if isinstance(value, tuple):
        return " ".join(map(str, value))
    return f"{value:,}" if isinstance(value, int) else str(value).replace("e-0", "e-")
