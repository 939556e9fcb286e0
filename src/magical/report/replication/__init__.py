"""Entries held against the published tables, cell by cell and claim by claim.

- `rows`: which entries can be, and which published row each method's are held against.
- `cells`: our run means and the published mean in one environment, and how far they are apart.
- `claims`: the paper's conclusions, from the published tables and from our entries.
- `picture`: the differences as a heat map.
"""
