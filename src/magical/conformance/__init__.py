"""Compares the package with recordings of the published environments.

There is a module for each kind of recording, with the same four functions: `load` reads a file,
`compute` computes the same quantities, `compare` compares the two, and `write` saves what was
computed. The recordings are in `data`, which has a README; `recordings` lists them.
"""
