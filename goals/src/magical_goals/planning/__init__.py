"""Control by planning with a motion model learned from demonstrations."""
