"""Demonstrations in other formats.

- `minari`: Minari datasets, one for each environment.
- `lerobot`: a LeRobotDataset v3.0.
- `video`: MP4 or animated WebP of both views with the score.
"""
