"""Augmented frames in compiled code: resampled, or rendered from a moved camera (appendix B).

Every function works on a batch in one call that releases the interpreter's lock.
"""

from magical.render.augmentation.moved_camera import MovedCamera
from magical.render.augmentation.noise import add_noise
from magical.render.augmentation.resampling import resample

__all__ = ["MovedCamera", "add_noise", "resample"]
