"""MAGICAL as a benchmark of vla-eval."""

from vla_eval_magical.benchmark import MagicalBenchmark

__all__ = ["MagicalBenchmark"]
