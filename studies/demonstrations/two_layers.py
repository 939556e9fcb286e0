"""`NETWORK`, `light` with the second linear layer of Fig. 11, and `NARROW`, `narrow` with it."""

from dataclasses import replace

from magical_baselines.networks import light, narrow

NETWORK = replace(light.NETWORK, HIDDEN=(256, 256))
NARROW = replace(narrow.NETWORK, HIDDEN=(256, 256))
HIDDEN, make_convolutions = NETWORK.HIDDEN, NETWORK.make_convolutions
