"""Changing images and actions of demonstrations: the paper's augmentations, and transformations."""
