"""Compares the package with recordings of the published environments.

There is a module for each kind of recording, with the same four functions: `load` reads a file,
`compute` produces what was recorded, `compare` compares the two, and `write` saves what was
computed. The recordings themselves are in `data`, which has a README; `recordings` finds them.
"""
