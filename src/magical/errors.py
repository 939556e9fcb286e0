"""Errors that a user can cause: each message says what was expected, what was found, what to do."""


class MagicalError(Exception):
    """Base of every error that the package raises on purpose."""


class UnknownNameError(MagicalError, ValueError):
    """An unknown name, such as that of a task, variant, preset, view, shape or colour."""


class InvalidSceneError(MagicalError, ValueError):
    """An impossible scene: overlapping or outside bodies, or values out of range."""


class PlacementError(MagicalError, RuntimeError):
    """No room was found for a body or region after a bounded number of proposals."""


class ObservationError(MagicalError, ValueError):
    """An observation whose shape, type or kind does not fit its use, or the rest of a batch."""


class InvalidActionError(MagicalError, ValueError):
    """An action out of range or of the wrong type."""


class ResetNeededError(MagicalError, RuntimeError):
    """`step` was called before `reset`, or after the end of the episode."""


class InvalidStateError(MagicalError, ValueError):
    """A saved environment state that does not fit the environment or is damaged."""


class InvalidTaskError(MagicalError, ValueError):
    """A task that cannot be registered, or whose score is not a number from 0 to 1."""


class InvalidProgramError(MagicalError, ValueError):
    """An expression of the goal language that is mistyped or cannot be the goal of any episode."""


class PolicyError(MagicalError, ValueError):
    """A policy that cannot be loaded, or that returned something other than actions."""


class PluginError(MagicalError, ImportError):
    """A plug-in or `module:NAME` that cannot be imported or has the wrong type."""


class NoExpertError(MagicalError, LookupError):
    """A task for which there is no scripted expert."""


class ScoresError(MagicalError, ValueError):
    """A file of scores that is damaged or not in the documented format."""


class TrajectoryError(MagicalError, ValueError):
    """A trajectory whose parts do not fit together, or that lacks what an observation needs."""


class DatasetError(MagicalError, RuntimeError):
    """A demonstration or dataset that is missing, damaged or unsafe, or cannot be written."""


class WorkerDiedError(MagicalError, RuntimeError):
    """A worker process exited or was killed."""


class MissingDependencyError(MagicalError, ImportError):
    """A library that is not installed, or in a version that does not fit; says what to install."""


class InvalidConfigError(MagicalError, ValueError):
    """A configuration with invalid values, or for another algorithm."""


class PlanError(MagicalError, ValueError):
    """A plan with unknown names, settings that cannot be combined, or the same run twice."""


class ClusterError(MagicalError, ConnectionError):
    """A Ray cluster that cannot be reached."""


class RunFolderError(MagicalError, RuntimeError):
    """A folder of a run or results that is in use, missing, damaged, of other contents, or full."""


class CheckpointError(MagicalError, ValueError):
    """A checkpoint that is missing, damaged or for another network or program."""


class DemonstrationsError(MagicalError, ValueError):
    """Demonstrations that cannot be learned from: too few, or for another task or observation."""


class DivergedError(MagicalError, ArithmeticError):
    """A loss, weights or logits that are not finite."""


class DeviceError(MagicalError, RuntimeError):
    """A device that is unknown, not available, or out of memory."""


class RenderError(MagicalError, ValueError):
    """A frame that cannot be rendered: poses or an array that do not fit, or an impossible size."""
