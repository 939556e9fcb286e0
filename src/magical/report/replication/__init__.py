"""Entries held against the published tables, cell by cell and claim by claim.

- `rows`: which entries can be, and which published row each method's are held against.
- `cells`: our run means and the published mean in one environment, and how far they are apart.
- `claims`: the paper's conclusions, from the published tables and from our entries.
- `generalisation`: Demo, TestAll and the gap between them, of methods without a published row too.
- `picture`: the differences as a heat map.
"""
