"""`light` with the second linear layer of Fig. 11; plans name it as `NETWORK` of this module."""

from types import SimpleNamespace

from magical.learning.networks.light import make_convolutions

HIDDEN = (256, 256)
NETWORK = SimpleNamespace(HIDDEN=HIDDEN, make_convolutions=make_convolutions)
