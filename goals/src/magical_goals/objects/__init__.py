"""Scenes as objects: parsed from pixels, related to each other, acted on.

- `parser`: finds the objects in frames, from connected `components` of colours.
- `table`: a batch of parsed scenes as tensors.
- `hindsight`: which block a demonstration moved, and where to, from the recorded frames alone.
- `relations`: how a block at a place relates to the other objects.
- `goals`: a model of which block is moved next and where to, from its relations.
- `control`: a network that moves the chosen block there, in the robot's frame.
"""
