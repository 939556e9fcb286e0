"""Poses recovered from the frames of the published human demonstrations.

- `fit`: poses fitted to the frames of one moment.
- `track`: all bodies followed from frame to frame.
- `recovery`: a whole recording, as a trajectory that says how well it is known.
"""
