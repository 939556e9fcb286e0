"""Control by planning with a motion that was learned from demonstrations."""
