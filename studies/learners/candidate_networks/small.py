"""`light` with a stride of 2 from the start and one layer more."""

from magical_baselines.networks.paper import ConvolutionStack

NETWORK = ConvolutionStack(((32, 5, 2), *[(64, 3, 2)] * 3), (256,))
HIDDEN, make_convolutions = NETWORK.HIDDEN, NETWORK.make_convolutions
