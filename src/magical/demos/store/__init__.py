"""Datasets on disk.

- `trajectory`: one recorded episode.
- `codec`: its file format, an .npz archive; `decode` reads files from anywhere safely.
- `manifest`: the list of a dataset's trajectories, with checksums.
- `reader`: a trajectory's observations, and its frames.
- `dataset`, `writer`: reading a dataset, and appending to it.
- `repair`: checking a dataset, and rebuilding its manifest.
- `summary`: counts and mean scores for each environment, duplicates.
- `provenance`: when and with which versions an episode was recorded.
"""
