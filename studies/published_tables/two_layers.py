"""`narrow` with the second linear layer of Fig. 11; plans name it as `NETWORK` of this module."""

from dataclasses import replace

from magical_baselines.networks import narrow

NETWORK = replace(narrow.NETWORK, HIDDEN=(256, 256))
HIDDEN, make_convolutions = NETWORK.HIDDEN, NETWORK.make_convolutions
