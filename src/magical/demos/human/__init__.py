"""The published human demonstrations.

- `download`: fetches the published files over HTTPS and checks their SHA-256 sums.
- `safe_pickle`: reads pickles of plain data without executing anything.
- `published`: one published file, as compressed frames or as a trajectory of 96 x 96 frames.
- `recovery`: the poses of all bodies, recovered from the frames.
- `importing`: appends published files to a dataset.
"""
